"""How right and how dear each level is, scene by scene: the judge of every change of `render`.

Pads, shipped scenes and random sensors are held against analog photons
(`tests.oracles.kept_photons`), the walk through slabs against adding-doubling. ``make scoreboard``
does some of them in minutes, ``make scoreboard-long`` all of them with more samples in hours; both
go on where they stopped, hold every row against what is kept in ``scoreboard.json``, and end with 1
where one has left its error bars or its cost. ``--keep`` writes what was found there instead.

From the command line, by name and level:
``python -m tests.validation.scoreboard "rim bent 45" "shipped digit" --levels reference``.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy import stats

from render.errors import RenderError
from render.files import write_text
from tests.long import LONG
from tests.oracles.kept_photons import PHI, SENSORS, WHOLE, photons_kept
from tests.oracles.pads import scene_of_case
from tests.validation.test_clear_pads import FAST, REPLICATES, compare
from tests.validation.test_slabs import FAST as FAST_SLABS
from tests.validation.test_slabs import MATERIALS, adding_doubling, walked

T = TypeVar("T")
KEPT = Path(__file__).with_suffix(".json")
ROOT = Path(__file__).parents[2]
FOUND = ROOT / "build" / "scoreboard"
"""What was found so far, in a folder for every state of the code."""
LEVELS = ("preview", "traced", "reference")
SAMPLES = 2000 if LONG else 400
ARRIVALS = 6_000_000 if LONG else 2_000_000
WALKS = 1 << (23 if LONG else 18)
SLABS = tuple(f"slab {number}" for number in range(len(MATERIALS)))
CASES = (
    (*SENSORS, *WHOLE, *SLABS) if LONG
    else (*SENSORS[:6], *FAST, *(SLABS[number] for number in FAST_SLABS))
)  # fmt: skip
SIGMA, SLACK = 3.5, 0.002
"""A ratio that differs by more has left its error bars: once in 2000 times by chance."""
DEARER = {"shipped": 1.3, "sensor": 1.3}
"""Allowed ratio of costs by the kind of scene; `DEARER_PADS` for all others."""
DEARER_PADS = 3.0


@dataclass(frozen=True)
class Row:
    """What one level says of one scene, against the truth.

    Arguments:
        scene, level: which.
        facets, sites: ratio of sums to the truth and its standard error, of the pressed and of the
            untouched pad; of slabs light that is reflected and transmitted.
        off: median over facets of ``|cell / truth - 1|``, noise of both included.
        rms_z: of facets and sites, in standard errors of both; None where a level states none.
        held: fraction of 95 % intervals that hold the truth, and how many there are; likewise.
        variance: median over facets of the squared relative standard error; likewise.
        seconds: of one core, kernels compiled; ``first`` those of a first run that compiles them.
            None where other programs ran beside it.
        memory: largest resident size of the process in MiB.
        refused: the sentence, where the level says that it cannot.
    """

    scene: str
    level: str
    facets: tuple[float, float] | None = None
    sites: tuple[float, float] | None = None
    off: float | None = None
    rms_z: float | None = None
    held: tuple[float, int] | None = None
    variance: float | None = None
    seconds: float | None = None
    first: float | None = None
    memory: float | None = None
    refused: str | None = None

    @property
    def cost(self) -> float | None:
        """Relative variance times seconds; where no noise is stated the seconds."""
        if self.seconds is None:
            return None
        return self.seconds * (1.0 if self.variance is None else self.variance)

    def line(self) -> str:
        """Return the row as a line of the table."""
        if self.refused:
            return f"{self.scene:40.40} {self.level:9} {self.refused}"

        def ratio(pair: tuple[float, float] | None) -> str:
            return " " * 17 if pair is None else f"{pair[0]:.4f} +- {pair[1]:.4f}"

        def number(value: float | None, form: str) -> str:
            return f"{'' if value is None else format(value, form):>7}"

        held = None if self.held is None else self.held[0]
        return (
            f"{self.scene:40.40} {self.level:9} {ratio(self.facets)}  {ratio(self.sites)} "
            f"{number(self.off, '.1%')} {number(self.rms_z, '.2f')} {number(held, '.1%')} "
            f"{number(self.seconds, '.2f')} {number(self.cost, '9.2e')} "
            f"{number(self.first, '.1f')} {number(self.memory, '.0f')}"
        )


TITLE = (
    f"{'scene':40} {'level':9} {'facets':17}  {'sites':17} {'off':>7} {'rms z':>7} {'held':>7} "
    f"{'core s':>8} {'cost':>9} {'first s':>7} {'MiB':>7}"
)


def held_against_photons(case: str, level: str, cells: Cells) -> Row:
    """Return the row of ``cells``: facets and sites with their standard errors."""
    ratios, z, p, off, variance = [], [], [], math.nan, None
    for pressed, (replicates, se) in zip((True, False), cells.targets, strict=True):
        truth = photons_kept(case, pressed)
        if len(replicates) == 1:  # a level that states no noise
            mean, known = truth.mean(axis=0).ravel(), truth.mean(axis=0).ravel() > 0.0
            whole = truth.reshape(len(truth), -1)[:, known].sum(axis=1)
            value = replicates[0][known].sum() / whole.mean()
            ratios.append((float(value), float(value * stats.sem(whole) / whole.mean())))
        else:
            result = compare(replicates, se, truth.reshape(len(truth), -1))
            ratios.append((result.ratio, result.error))
            z.append(result.z)
            p.append(result.p)
            mean = truth.mean(axis=0).ravel()
            known = np.isfinite(replicates).all(axis=0) & (mean > 0.0)
            if pressed:
                relative = se[known] / replicates[:, known].mean(axis=0)
                variance = float(np.median(relative**2))
        if pressed:
            average = replicates.mean(axis=0)
            off = float(np.median(np.abs(average[known] / mean[known] - 1.0)))
    every_z, every_p = (np.concatenate(parts) if parts else None for parts in (z, p))
    return Row(
        case,
        level,
        facets=ratios[0],
        sites=ratios[1],
        off=off,
        rms_z=None if every_z is None else float(np.sqrt((every_z**2).mean())),
        held=None if every_p is None else (float((every_p >= 0.05).mean()), every_p.size),
        variance=variance,
        seconds=cells.seconds,
        first=cells.first,
    )


@dataclass(frozen=True)
class Cells:
    """Facets and sites of a level: replicates ``(replicate, cell)`` and standard errors each."""

    targets: tuple[tuple[np.ndarray, np.ndarray], ...]
    seconds: float
    first: float


def in_core_seconds(run: Callable[[], T]) -> tuple[T, float]:
    """Return what ``run`` returns, and the processor time of all cores that it took."""
    began = time.process_time()
    return run(), time.process_time() - began


def reference_cells(case: str) -> Cells:
    """Return those of level 2 in the directions of the photons."""
    from render.reference import render_transport

    scene = scene_of_case(case)

    def render(samples: int) -> object:
        return render_transport(
            scene, np.array([PHI]), np.array(scene.bending.angles[:1]), samples=samples,
            replicates=REPLICATES,
        )  # fmt: skip

    # Kernels do not depend on the number of samples.
    _, first = in_core_seconds(lambda: render(1))
    found, seconds = in_core_seconds(lambda: render(SAMPLES))
    return Cells(
        (
            (found.replicates.reshape(REPLICATES, -1), found.se.ravel()),
            (found.background_replicates.reshape(REPLICATES, -1), found.background_se.ravel()),
        ),
        seconds,
        first,
    )


def preview_cells(case: str) -> Cells:
    """Return those that the shader draws."""
    from render.preview import Preview

    scene, bend = scene_of_case(case), np.array([scene_of_case(case).bending.angles[0]])

    def draw() -> list[np.ndarray]:
        with Preview(scene) as preview:
            return [each[:, 0, 0] for each in preview.transport(np.array([PHI]), bend)]

    _, first = in_core_seconds(draw)
    drawn, seconds = in_core_seconds(draw)
    return Cells(tuple((one.reshape(1, -1), np.zeros(one.size)) for one in drawn), seconds, first)


def traced_cells(case: str) -> Cells:
    """Return those of the light that compiled paths trace."""
    from render.preview.converged import Effort, transport_at
    from render.progress import Clock

    scene = scene_of_case(case)

    def trace(effort: Effort) -> np.ndarray:
        bend, phi = scene.bending.angles[0], np.array([PHI])
        return transport_at(scene, bend, phi, effort, Clock(1, None)).cells[:, 0]

    few = Effort(photons=1000, paths=64, arrivals=1000)
    _, first = in_core_seconds(lambda: trace(few))
    effort = Effort(photons=60_000, paths=8192, arrivals=ARRIVALS)
    cells, seconds = in_core_seconds(lambda: trace(effort))
    targets = (cells[..., :-1], cells[..., -1])
    return Cells(tuple((one.reshape(1, -1), np.zeros(one.size)) for one in targets), seconds, first)


def slab_row(case: str) -> Row:
    """Return how much the walk of level 2 reflects and transmits, over adding-doubling."""
    from render.reference.llvm import mitsuba

    mono = mitsuba()
    material = MATERIALS[int(case.removeprefix("slab "))]
    _, first = in_core_seconds(lambda: walked(mono, material, 1 << 10, 1))
    parts, seconds = in_core_seconds(lambda: walked(mono, material, WALKS, 1))
    expected = np.array(adding_doubling(material))
    ratio, error = parts.mean(axis=0) / expected, stats.sem(parts) / expected
    z = (ratio - 1.0) / error
    p = 2 * stats.t.sf(np.abs(z), len(parts) - 1)
    pairs = [(float(value), float(bar)) for value, bar in zip(ratio, error, strict=True)]
    return Row(
        case, "reference", facets=pairs[0], sites=pairs[1], off=float(np.abs(ratio - 1.0).max()),
        rms_z=float(np.sqrt((z**2).mean())), held=(float((p >= 0.05).mean()), p.size),
        variance=float((error**2).mean()), seconds=seconds, first=first,
    )  # fmt: skip


CELLS = {"preview": preview_cells, "traced": traced_cells, "reference": reference_cells}


def row(case: str, level: str) -> Row:
    """Return the row of a scene and level, made in this process."""
    if case in SLABS:
        return slab_row(case)
    try:
        return held_against_photons(case, level, CELLS[level](case))
    except RenderError as error:
        return Row(case, level, refused=str(error))


def row_of_its_own(case: str, level: str) -> Row:
    """Return the row as a process of its own makes it: its memory, its kernels compiled anew."""
    with tempfile.TemporaryDirectory() as home:
        command = [sys.executable, "-m", "tests.validation.scoreboard", "--row", case, level]
        # Dr.Jit keeps kernels there. Compiled paths are the same for all scenes.
        fresh = {"HOME": home} if level == "reference" else {}
        done = subprocess.run(
            command, env=os.environ | fresh, capture_output=True, text=True, check=False
        )
    if done.returncode:
        return Row(case, level, refused=f"ended with {done.returncode}: {done.stderr[-300:]}")
    return read_row(json.loads(done.stdout.splitlines()[-1]))


def read_row(content: dict[str, object]) -> Row:
    """Return the row of a JSON object."""
    pairs = {name: tuple(content[name]) for name in ("facets", "sites", "held") if content[name]}  # type: ignore[arg-type]
    return Row(**(content | pairs))  # type: ignore[arg-type]


def judged(now: Row, before: Row | None) -> list[str]:
    """Return what has become worse than ``before``, beyond error bars and allowed cost."""
    if before is None:
        return []
    if now.refused or before.refused:
        return [] if now.refused == before.refused else [f"was: {before.refused or 'rendered'}"]
    found = []
    for name in ("facets", "sites"):
        (value, error), (old, old_error) = getattr(now, name), getattr(before, name)
        # Levels without noise of their own are held against the same photons.
        bar = math.hypot(error, old_error) if now.rms_z is not None else 0.0
        if abs(value - 1.0) > abs(old - 1.0) and abs(value - old) > SIGMA * bar + SLACK:
            found.append(f"{name} {old:.4f} -> {value:.4f}")
    if now.held and before.held:
        held, count = now.held
        if stats.binom.cdf(round(held * count), count, min(before.held[0], 0.95)) < 1e-3:
            found.append(f"held {before.held[0]:.1%} -> {held:.1%}")
    allowed = DEARER.get(now.scene.split()[0], DEARER_PADS)
    if now.cost and before.cost and now.cost > allowed * before.cost:
        found.append(f"cost {now.cost / before.cost:.2f} times, allowed {allowed:g}")
    return found


def rows_wanted(cases: Iterable[str], levels: Iterable[str]) -> list[tuple[str, str]]:
    """Return the scenes and levels of the table, slabs at level 2 alone."""
    return [
        (case, level) for case in cases for level in levels
        if case not in SLABS or level == "reference"
    ]  # fmt: skip


def main() -> None:
    """Make the table, or one row."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE")
    parser.add_argument("--levels", nargs="+", choices=LEVELS, default=LEVELS)
    parser.add_argument("--row", nargs=2, metavar=("CASE", "LEVEL"), help=argparse.SUPPRESS)
    parser.add_argument("--keep", action="store_true", help="what was found becomes what is kept")
    asked = parser.parse_args()
    if asked.row:
        made = asdict(row(*asked.row))
        made["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(json.dumps(made))
        return
    sys.exit(_table(asked.cases or CASES, asked.levels, keep=asked.keep))


def found_folder() -> Path:
    """Return where rows of this state of the code and of these samples are found again."""
    code = sha256(f"{SAMPLES} {ARRIVALS} {WALKS}".encode())
    for path in sorted((ROOT / "render").rglob("*")):
        if path.suffix in (".py", ".glsl", ".toml"):
            code.update(path.read_bytes())
    return FOUND / code.hexdigest()[:16]


def found_again(case: str, level: str) -> Row:
    """Return the row, made or as it was found before."""
    path = found_folder() / f"{case.replace(' ', '-')}-{level}.json"
    if path.is_file():
        return read_row(json.loads(path.read_text(encoding="utf-8")))
    made = row_of_its_own(case, level)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(asdict(made)))
    return made


def _table(cases: Iterable[str], levels: Iterable[str], *, keep: bool) -> int:
    effort = f"{SAMPLES} samples, {ARRIVALS} arrivals, {WALKS} walks"
    kept = json.loads(KEPT.read_text()) if KEPT.is_file() else {}
    before = {(one["scene"], one["level"]): read_row(one) for one in kept.get(effort, [])}
    now, worse = {}, 0
    print(TITLE)
    for case, level in rows_wanted(cases, levels):
        made = found_again(case, level)
        now[case, level] = made
        faults = judged(made, before.get((case, level)))
        worse += bool(faults)
        print(made.line() + "".join(f"\n    WORSE: {fault}" for fault in faults), flush=True)
    if keep:
        merged = before | now
        kept[effort] = [asdict(merged[key]) for key in sorted(merged)]
        write_text(KEPT, json.dumps(kept, indent=1) + "\n")
        return 0
    return 1 if worse else 0


if __name__ == "__main__":
    main()
