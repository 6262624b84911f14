"""The transport table: passes over all pads, each in order of what the score is made of.

A pass renders every bend, pressed and untouched, with a seed of its own; the passes' weighted mean
is the table. In every pass the scene's own bends come first, pressed before untouched, because all
scores are made of them, then the bends between.
"""

from __future__ import annotations

import numpy as np

from optimize.design.design import Array
from optimize.overnight.amounts import JOB_SECONDS, OVERDUE, PASSES_MIN, TABLE_UNTIL, Pace
from optimize.overnight.runner import OutOfTime
from optimize.overnight.shift import Shift
from optimize.scoring.measure import check_seen
from render.chebyshev import chebyshev_nodes
from render.progress import Clock
from render.reference.job import PadJob, PadResult
from render.reference.transport import gather, pad_jobs
from render.scene.schema import Scene
from render.transport import TransportTable
from surrogate.training.render_plan import training_bends

PHI_NODES = 11
BEND_NODES = 3, 5
"""Bends of the table besides the scene's own, of a short run and of a long one: the latter's model
knows the bends between as well."""
LONG = 1.0, 2000
"""Hours, or samples, of a long run."""
PILOT = (8, 200)
"""Samples of the trial renders: next to none, and enough paths at once for full speed."""
PILOT_PURPOSE, TABLE_PURPOSE = 1, 2


def measured_pace(shift: Shift) -> Pace:
    """Return how fast renders are here, by trial renders at the first bend."""

    def trial() -> dict[str, float]:
        shift.stage("Trial renders", "trial")
        phi = chebyshev_nodes(PHI_NODES, 0.0, np.pi)
        seed = shift.random_seed(PILOT_PURPOSE, 0)
        jobs: list[PadJob] = []
        # The smallest ones first, so that nobody measures how long kernels take to compile.
        for samples in (PILOT[0], *PILOT):
            jobs += pad_jobs(
                shift.scene, phi, shift.bends[:1], samples=samples, seeds=[seed + len(jobs)]
            )
        clock = Clock(sum(job.samples for job in jobs), shift.progress)
        seconds = [result.seconds for job in jobs for result in shift.renders([job], clock)]
        pace = Pace.of(jobs[2:], seconds[2:], 1)
        return {"fixed": pace.fixed, "each": pace.each}

    found = shift.decide("pace", trial)
    return Pace(found["fixed"], found["each"], shift.renders.workers.count)


def render_table(shift: Shift, pace: Pace | None) -> None:
    """Render this shift's passes."""
    if shift.decided("table") is not None:
        return
    passes = _passes(shift, pace)
    shift.stage("Transport table", "table")
    seeds: list[int] = []
    group = max(1, 2 * shift.renders.workers.count // (2 * len(table_bends(shift))))
    while len(seeds) < passes["passes"]:
        first = len(seeds)

        def another(first: int = first) -> list[int]:
            last = min(first + group, passes["passes"])
            return [shift.random_seed(TABLE_PURPOSE, i) for i in range(first, last)]

        def affordable(first: int = first, pace: Pace | None = pace) -> list[int]:
            if first and pace is not None:
                jobs = _jobs(shift, passes["samples"], another(first))
                # Half a pass too many is as good as half a pass too few.
                if pace.seconds(jobs) / 2 > shift.left_until(TABLE_UNTIL):
                    return []
            return another(first)

        chosen = shift.decide(f"table passes from {first}", affordable)
        if not chosen:
            break
        began = shift.store.spent()
        jobs = _jobs(shift, passes["samples"], chosen)
        clock = Clock(sum(job.samples for job in jobs), shift.progress)
        late = shift.at(TABLE_UNTIL + OVERDUE) if first else None
        try:
            if shift.decided(f"table passes from {first} given up") is not None:
                break
            with shift.renders.until(late):
                shift.renders(jobs, clock)
        except OutOfTime:
            shift.decide(f"table passes from {first} given up", lambda: True)
            break
        if pace is not None and clock.worked == clock.total:
            # From here on what was seen counts, not what the trial promised.
            pace = _corrected(pace, jobs, shift.store.spent() - began)
        seeds += chosen
    shift.decide(
        "table",
        lambda: {
            "samples": passes["samples"],
            "seeds": seeds,
            "pace": None if pace is None else {"fixed": pace.fixed, "each": pace.each},
        },
    )


def seen_pace(shift: Shift) -> Pace | None:
    """Return the pace that the table's renders had; None for a fixed amount of work."""
    found = shift.decided("table")["pace"]
    return None if found is None else Pace(**found, workers=shift.renders.workers.count)


def whole_table(shift: Shift) -> TransportTable:
    """Return the mean of all passes of all shifts so far, weighted by their samples."""
    parts: list[tuple[int, TransportTable]] = []
    for number in range(1, shift.number + 1):
        found = shift.store.decided(f"{number}/table")
        for seed in found["seeds"]:
            jobs = _jobs(shift, found["samples"], [seed])
            results = shift.renders(jobs, Clock(sum(job.samples for job in jobs), None))
            parts.append((found["samples"], _table(shift.scene, jobs, results)))
    return _mean(parts)


def table_bends(shift: Shift) -> Array:
    """Return the bends of the table in rad, in order of value: the scene's own ones first.

    The first shift chooses, because all passes must have the same.
    """

    def choose() -> int:
        if shift.fixed is not None:
            return BEND_NODES[shift.fixed.samples >= LONG[1]]
        return BEND_NODES[shift.until - shift.began >= 3600 * LONG[0]]

    nodes = shift.store.decide("bend nodes", choose)
    own = shift.bends
    between = [b for b in training_bends(shift.scene, nodes) if np.abs(own - b).min() > 1e-6]
    return np.concatenate([own, between])


def _passes(shift: Shift, pace: Pace | None) -> dict[str, int]:
    """Return the number of passes and their samples per cell."""

    def choose() -> dict[str, int]:
        if shift.fixed is not None:
            return {"passes": shift.fixed.passes, "samples": shift.fixed.per_pass}
        assert pace is not None  # with hours it is measured
        unit = _jobs(shift, 64, [0])
        work = max(shift.left_until(TABLE_UNTIL), 1.0) * pace.workers
        shared = -(-PASSES_MIN * pace.workers // len(unit)) if pace.workers > 1 else 0
        passes = max(PASSES_MIN, shared, round(work / (JOB_SECONDS * len(unit))))
        samples = pace.samples(unit, 64, work / passes / min(pace.workers, len(unit)))
        return {"passes": passes, "samples": samples}

    found: dict[str, int] = shift.decide("passes", choose)
    return found


def _jobs(shift: Shift, samples: int, seeds: list[int]) -> list[PadJob]:
    phi, bends = chebyshev_nodes(PHI_NODES, 0.0, np.pi), table_bends(shift)
    jobs = pad_jobs(shift.scene, phi, bends, samples=samples, seeds=seeds)
    ranks = {bend: int(i >= len(shift.bends)) for i, bend in enumerate(bends.tolist())}
    return sorted(jobs, key=lambda job: (seeds.index(job.seed), ranks[job.bend], not job.indented))


def _corrected(pace: Pace, jobs: list[PadJob], seconds: float) -> Pace:
    ratio = seconds / pace.seconds(jobs)
    return Pace(pace.fixed * ratio, pace.each * ratio, pace.workers)


def _table(scene: Scene, jobs: list[PadJob], results: list[PadResult]) -> TransportTable:
    found = gather(scene, jobs, results, 0)
    check_seen(found.replicates)
    bends = np.array(list(dict.fromkeys(job.bend for job in jobs)))
    order = np.argsort(bends)
    return TransportTable(
        T=found.T[:, :, order],
        se=found.se[:, :, order],
        phi=np.array(jobs[0].phi[0]),
        exposure=1.0,
        lam=0.0,
        scene_hash=scene.hash,
        level="reference",
        bends=bends[order],
        background=found.background[:, :, order],
        background_se=found.background_se[:, :, order],
    )


def _mean(parts: list[tuple[int, TransportTable]]) -> TransportTable:
    """Return the weighted mean; its standard errors follow from those of the parts."""
    total = sum(weight for weight, _ in parts)
    first = parts[0][1]

    def mean(name: str) -> Array:
        return np.asarray(sum(weight / total * getattr(part, name) for weight, part in parts))

    def error(name: str) -> Array:
        squares = sum((weight / total * getattr(part, name)) ** 2 for weight, part in parts)
        return np.asarray(np.sqrt(np.asarray(squares)))

    return TransportTable(
        T=mean("T"),
        se=error("se"),
        phi=first.phi,
        exposure=1.0,
        lam=0.0,
        scene_hash=first.scene_hash,
        level="reference",
        bends=first.bends,
        background=mean("background"),
        background_se=error("background_se"),
    )
