"""The stages that make the surrogate: trial renders, the transport table, the fit.

A pass of the table renders every bend, pressed and untouched, with a seed of its own; the passes'
weighted mean is the table. In every pass the scene's own bends come first, pressed before
untouched, because all scores are made of them, then the bends between. A model that is whole and
was logged is not fitted again; a damaged one is, and comes out the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from optimize.design import Array
from optimize.overnight.context import (
    FIT_STEPS,
    JOB_SECONDS,
    MIN_PASSES,
    MODEL_UNTIL,
    OVERTIME_SHARE,
    TABLE_UNTIL,
    RunContext,
    samples_within,
)
from optimize.overnight.store import TABLE
from optimize.scoring import check_visible
from render.chebyshev import chebyshev_nodes
from render.errors import ModelError
from render.progress import Clock
from render.reference import RenderCost, RenderJob, RenderResult, transport_estimate, transport_jobs
from render.scene import Scene
from render.transport import TransportTable
from surrogate.runtime import MODEL_FILE, Checker, sha256
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


def measured_cost(context: RunContext) -> RenderCost:
    """Return how fast renders are here, by trial renders at the first bend."""

    def trial() -> dict[str, float]:
        context.stage("Trial renders", "trial")
        phi = chebyshev_nodes(PHI_NODES, 0.0, np.pi)
        seed = context.random_seed(PILOT_PURPOSE, 0)
        jobs: list[RenderJob] = []
        # The smallest ones first, so that nobody measures how long kernels take to compile.
        for samples in (PILOT[0], *PILOT):
            jobs += transport_jobs(
                context.scene, phi, context.bends[:1], samples=samples, seeds=[seed + len(jobs)]
            )
        clock = Clock(sum(job.samples for job in jobs), context.progress)
        seconds = [result.seconds for job in jobs for result in context.renders([job], clock)]
        half = len(jobs) // 3
        small, large = slice(half, 2 * half), slice(2 * half, None)
        cost = RenderCost.fitted(
            [sum(job.samples for job in jobs[part]) for part in (small, large)],
            [sum(seconds[part]) for part in (small, large)],
            jobs=half,
        )
        return {"fixed": cost.fixed, "each": cost.per_sample}

    kept = context.decide("pace", trial)
    return _cost_of(context, kept)


def _cost_of(context: RunContext, kept: dict[str, float]) -> RenderCost:
    return RenderCost(kept["fixed"], kept["each"], context.renders.workers.count)


def render_table(context: RunContext, cost: RenderCost | None) -> None:
    """Render this period's passes."""
    if context.decided("table") is not None:
        return
    passes = _passes(context, cost)
    context.stage("Transport table", "table")
    seeds: list[int] = []
    group = max(1, 2 * context.renders.workers.count // (2 * len(table_bends(context))))
    while len(seeds) < passes["passes"]:
        first = len(seeds)

        def another(first: int = first) -> list[int]:
            last = min(first + group, passes["passes"])
            return [context.random_seed(TABLE_PURPOSE, i) for i in range(first, last)]

        def affordable(first: int = first, cost: RenderCost | None = cost) -> list[int]:
            if first and cost is not None:
                jobs = _jobs(context, passes["samples"], another(first))
                # Half a pass too many is as good as half a pass too few.
                if cost.seconds(jobs) / 2 > context.seconds_until(TABLE_UNTIL):
                    return []
            return another(first)

        chosen = context.decide(f"table passes from {first}", affordable)
        if not chosen:
            break
        began = context.store.spent()
        jobs = _jobs(context, passes["samples"], chosen)
        clock = Clock(sum(job.samples for job in jobs), context.progress)
        late = context.deadline(TABLE_UNTIL + OVERTIME_SHARE) if first else None
        render = partial(context.renders, jobs, clock)
        if context.within(f"table passes from {first}", late, render) is None:
            break
        if cost is not None and clock.worked == clock.total:
            # From here on what was seen counts, not what the trial predicted.
            cost = _corrected(cost, jobs, context.store.spent() - began)
        seeds += chosen
    context.decide(
        "table",
        lambda: {
            "samples": passes["samples"],
            "seeds": seeds,
            "pace": None if cost is None else {"fixed": cost.fixed, "each": cost.per_sample},
        },
    )


def observed_cost(context: RunContext) -> RenderCost | None:
    """Return the cost that the table's renders had; None for a fixed amount of work."""
    kept = context.decided("table")["pace"]
    return None if kept is None else _cost_of(context, kept)


def pooled_table(context: RunContext) -> TransportTable:
    """Return the mean of all passes of all periods so far, weighted by their samples."""
    parts: list[tuple[int, TransportTable]] = []
    for number in range(1, context.number + 1):
        passes = context.store.decided(f"{number}/table")
        for seed in passes["seeds"]:
            jobs = _jobs(context, passes["samples"], [seed])
            results = context.renders(jobs, Clock(sum(job.samples for job in jobs), None))
            parts.append((passes["samples"], _table(context.scene, jobs, results)))
    return _mean(parts)


def table_bends(context: RunContext) -> Array:
    """Return the bends of the table in rad, in order of value: the scene's own ones first.

    The first period chooses, because all passes must have the same.
    """

    def choose() -> int:
        if context.fixed is not None:
            return BEND_NODES[context.fixed.samples >= LONG[1]]
        return BEND_NODES[context.until - context.began >= 3600 * LONG[0]]

    nodes = context.store.decide("bend nodes", choose)
    wanted = context.bends
    between = [b for b in training_bends(context.scene, nodes) if np.abs(wanted - b).min() > 1e-6]
    return np.concatenate([wanted, between])


def _passes(context: RunContext, cost: RenderCost | None) -> dict[str, int]:
    """Return the number of passes and their samples per cell."""

    def choose() -> dict[str, int]:
        if context.fixed is not None:
            return {"passes": context.fixed.passes, "samples": context.fixed.per_pass}
        assert cost is not None  # with hours it is measured
        unit = _jobs(context, 64, [0])
        work = max(context.seconds_until(TABLE_UNTIL), 1.0) * cost.workers
        shared = -(-MIN_PASSES * cost.workers // len(unit)) if cost.workers > 1 else 0
        passes = max(MIN_PASSES, shared, round(work / (JOB_SECONDS * len(unit))))
        samples = samples_within(cost, unit, 64, work / passes / min(cost.workers, len(unit)))
        return {"passes": passes, "samples": samples}

    amount: dict[str, int] = context.decide("passes", choose)
    return amount


def _jobs(context: RunContext, samples: int, seeds: list[int]) -> list[RenderJob]:
    phi, bends = chebyshev_nodes(PHI_NODES, 0.0, np.pi), table_bends(context)
    jobs = transport_jobs(context.scene, phi, bends, samples=samples, seeds=seeds)
    ranks = {bend: int(i >= len(context.bends)) for i, bend in enumerate(bends.tolist())}
    return sorted(jobs, key=lambda job: (seeds.index(job.seed), ranks[job.bend], not job.indented))


def _corrected(cost: RenderCost, jobs: list[RenderJob], seconds: float) -> RenderCost:
    ratio = seconds / cost.seconds(jobs)
    return RenderCost(cost.fixed * ratio, cost.per_sample * ratio, cost.workers)


def _table(scene: Scene, jobs: list[RenderJob], results: list[RenderResult]) -> TransportTable:
    estimate = transport_estimate(scene, jobs, results, 0)
    check_visible(estimate.replicates)
    bends = np.array(list(dict.fromkeys(job.bend for job in jobs)))
    order = np.argsort(bends)
    return TransportTable(
        T=estimate.T[:, :, order],
        se=estimate.se[:, :, order],
        phi=np.array(jobs[0].phi[0]),
        exposure=1.0,
        lam=0.0,
        scene_hash=scene.hash,
        level="reference",
        bends=bends[order],
        background=estimate.background[:, :, order],
        background_se=estimate.background_se[:, :, order],
    )


def _mean(parts: list[tuple[int, TransportTable]]) -> TransportTable:
    """Return the weighted mean; its standard errors follow from those of the parts."""
    total = sum(weight for weight, _ in parts)

    def mean(name: str) -> Array:
        return np.asarray(sum(weight / total * getattr(part, name) for weight, part in parts))

    def error(name: str) -> Array:
        squares = sum((weight / total * getattr(part, name)) ** 2 for weight, part in parts)
        return np.asarray(np.sqrt(np.asarray(squares)))

    return replace(
        parts[0][1],
        T=mean("T"),
        se=error("se"),
        background=mean("background"),
        background_se=error("background_se"),
    )


MODEL = "model"
TRIAL_STEPS = 60
HELD_OUT_FACTOR = 1.9
"""The networks for held-out fibers, directions and bends take about this many times the steps."""
FIT_OVERHEAD_SECONDS = 30.0
"""Seconds of a fit around the networks: the preview's grid, ridge, errors, export."""


def fit_model(context: RunContext, table: Callable[[], TransportTable]) -> Checker:
    """Return the surrogate that is fitted to ``table``, which is read only where it is needed."""
    folder = context.store.run / MODEL
    known = context.decided("model")
    if known is not None:
        fitted = _whole(context, known["sha256"])
        if fitted is not None:
            return fitted
        context.log.note(f"{folder} is missing or damaged: the surrogate is fitted again")
        for item in folder.glob("*") if folder.is_dir() else ():
            item.unlink()
    from surrogate.train import TrainConfig, train

    context.stage("Surrogate", "surrogate")
    steps = context.decide("fit", lambda: {"steps": _steps(context, table())})["steps"]
    config = TrainConfig()
    network = replace(config.fit.network, steps=steps)

    began = time.monotonic()
    train(
        # The table is of the scene's own material, whatever it leaves free.
        context.scene.model_copy(update={"free": None}),
        folder,
        seed=context.seed,
        table=table(),
        run=context.store.run / TABLE,
        config=replace(config, fit=replace(config.fit, network=network)),
        command=f"tactilux overnight {context.scene.name} --seed {context.seed}",
        progress=context.progress,
    )
    digest = sha256((folder / MODEL_FILE).read_bytes())
    context.decide("model", lambda: {"sha256": digest, "seconds": time.monotonic() - began})
    refitted = _whole(context, context.decided("model")["sha256"])
    if refitted is None:
        raise ModelError(
            f"{folder} was fitted again to the same renders and came out different: this is "
            "another processor type or another version; start anew in another directory",
            field="model",
        )
    return refitted


def _whole(context: RunContext, digest: str) -> Checker | None:
    """Return the model in the run directory if it is the one of that SHA-256."""
    folder = context.store.run / MODEL
    try:
        if sha256((folder / MODEL_FILE).read_bytes()) != digest:
            return None
        return Checker.load(folder, context.scene.hash)
    except (OSError, ModelError):
        return None


def _steps(context: RunContext, table: TransportTable) -> int:
    """Return the steps that fit the time, after timing a few on data of the same size."""
    if context.fixed is not None:
        return context.fixed.fit_steps
    low, high = FIT_STEPS
    per_step = HELD_OUT_FACTOR * _seconds_per_step(table)
    free = context.seconds_until(MODEL_UNTIL) - FIT_OVERHEAD_SECONDS
    return min(high, max(low, int(free / per_step)))


def _seconds_per_step(table: TransportTable) -> float:
    import torch

    from surrogate.model.facet_basis import SIZE
    from surrogate.model.features import FEATURE_NAMES
    from surrogate.training.dataset import RegressionData
    from surrogate.training.fit import FitConfig
    from surrogate.training.mlp import fit_networks

    config = FitConfig()
    directions, count = len(table.phi), config.network.batch
    shape = (directions, count, 1, 1)
    rows = directions * count
    normals = table.T.shape[4] + 1
    data = RegressionData(
        x=torch.zeros(rows, len(FEATURE_NAMES)),
        basis=torch.zeros(rows, SIZE, normals),
        ratio=torch.ones(rows, normals),
        noise=torch.ones(rows, normals),
        log_preview=np.zeros((*shape, normals)),
    )
    fold = np.arange(directions * count).reshape(shape[:3]) % config.members
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        seconds = []
        # The first fit of a process takes seconds longer than any other.
        for steps in (1, 1, TRIAL_STEPS):
            began = time.monotonic()
            network = replace(config.network, steps=steps)
            fit_networks(data, fold, config.members, network, 0)
            seconds.append(time.monotonic() - began)
    finally:
        torch.set_num_threads(threads)
    return max(seconds[2] - seconds[1], 1e-4) / (TRIAL_STEPS - 1)
