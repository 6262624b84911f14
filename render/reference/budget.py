"""Work within a given time: renders that measure what they cost and plan the rest of themselves.

No trial render says what a sample costs elsewhere, at another bend, or while other programs want
the processor. So renders with a time instead of a number of samples are made in rounds. A round
adds whole passes to every job, whose paths go on where they stood (``per_pass`` of
``transport_jobs``), and times each pass by itself, apart from loading the pad and compiling. What
the next round may add follows from that and from the time left. Nothing that was rendered is lost,
and the number of samples that comes out is as good as one that was asked for: the same number of
the same passes gives the same bits, in one go or in many rounds.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from render.files import read_json, read_or_drop, write_json, write_npz
from render.progress import OnProgress, Progress
from render.reference.job import RenderJob, RenderResult, run_job

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

ROUND_FRACTION = 0.6
"""Part of the remaining time that a round plans to use, while it is not the last one."""
LAST_UNITS = 4.0
"""Where so few units remain, or where loading takes LOADING_FRACTION of what remains, the round is
the last one."""
LOADING_FRACTION = 0.1
OVERTIME_FRACTION = 0.04
"""Part of all the time by which a round may be late before it is given up for the one before."""
COMPILED_FRACTION = 0.1
"""Part of the seconds of the first small render of a pad, flat or bent, pressed or not, that the
next one takes with the same kernels (``finger20``: 5 to 8 s, then 0.6)."""
TOLERANCE = 0.1
"""Part of all the time by which work may be late without a word."""
CORRECTION = 1.25
"""Time over the one that was announced from which it is announced anew."""


@dataclass(frozen=True)
class TimeBudget:
    """Seconds that work may take, from its beginning.

    It ``began`` by ``clock``, which never goes back. ``announced`` are the seconds that somebody
    was told it takes at least; 0 where nothing was said.

    Example:
        >>> budget = TimeBudget(60.0, began=5.0, clock=lambda: 25.0)
        >>> budget.spent(), budget.left()
        (20.0, 40.0)
    """

    seconds: float
    began: float
    clock: Callable[[], float] = time.monotonic
    announced: float = 0.0

    @classmethod
    def of_minutes(cls, minutes: float, began: float | None = None) -> TimeBudget:
        """Return the budget of ``minutes`` from ``began`` (``time.monotonic()``), or from now."""
        return cls(60.0 * minutes, time.monotonic() if began is None else began)

    def spent(self) -> float:
        """Return the seconds since the work began."""
        return self.clock() - self.began

    def left(self) -> float:
        """Return the seconds that remain; negative when it is too late."""
        return self.seconds - self.spent()

    def charged(self, seconds: float) -> TimeBudget:
        """Return the same budget with ``seconds`` more spent on it, by earlier attempts."""
        return replace(self, began=self.began - seconds)

    def warning(self, least: float) -> str:
        """Return a sentence where the rest takes ``least`` s or more, and that is too long.

        Of what was announced, only a correction is worth another sentence.
        """
        whole = self.spent() + least
        if whole <= max((1 + TOLERANCE) * self.seconds, CORRECTION * self.announced):
            return ""
        minutes = math.ceil(whole / 0.6) / 100
        asked = f"{self.seconds / 60:.2g}"
        return (
            f"{asked} {'minute is' if asked == '1' else 'minutes are'} too few: with the fewest "
            f"samples this takes some {minutes:g} minutes here, and is late by the difference."
        )

    def announcing(self, least: float) -> TimeBudget:
        """Return the same budget after somebody was told that the rest takes ``least`` s."""
        return replace(self, announced=self.spent() + least)

    def progress(self) -> Progress:
        """Return how far it is: of work that fills its time, the clock says that."""
        spent, left = self.spent(), max(self.left(), 0.0)
        return Progress(min(spent, self.seconds), self.seconds, spent, left)


def no_reserve() -> float:
    """Return 0 s, where renders are the last that takes time."""
    return 0.0


def render_within(
    jobs: Sequence[RenderJob],
    budget: TimeBudget,
    folder: Path,
    *,
    reserve: Callable[[], float] = no_reserve,
    progress: OnProgress | None = None,
    run: Callable[..., RenderResult] = run_job,
) -> int:
    """Return how many times ``jobs`` fit into the time, at least once; all of that is rendered.

    Where once takes too long, ``progress`` is told a note with the least time, as soon as jobs show
    that.

    The results are in ``folder`` as ``render_transport`` keeps them, of jobs with so many times the
    iterations. Beside them lie the states of their paths: a later call with more time adds to them.
    An interrupted call goes on where it stood, and what it had taken counts.

    ``jobs`` are all those of one unit, with paths of ``per_pass`` samples (``transport_jobs``);
    ``budget`` is of everything, with what went before and comes after, and ``reserve`` returns the
    seconds that must remain, asked again before every round. States and results are in ``folder``.
    """
    return _Rounds(jobs, budget, folder, reserve, progress, run).fill()


class _Late(Exception):
    """A round takes longer than it may."""


@dataclass
class _Pace:
    """Measured seconds of a job: to load it, and per pass; not clean with compiling in them."""

    load: float
    each: float
    clean: bool


class _Rounds:
    def __init__(
        self,
        jobs: Sequence[RenderJob],
        budget: TimeBudget,
        folder: Path,
        reserve: Callable[[], float],
        progress: OnProgress | None,
        run: Callable[..., RenderResult],
    ) -> None:
        self.jobs, self.folder, self.reserve = list(jobs), folder, reserve
        self.progress, self.run = progress, run
        states = [read_or_drop(self._state(job)) for job in self.jobs]
        kept = [state for state in states if state is not None]
        self.budget = budget.charged(sum(float(state["seconds"]) for state in kept))
        self.kept = max(
            (
                -(-int(state["done"]) // job.iterations)
                for job, state in zip(self.jobs, states, strict=True)
                if state is not None
            ),
            default=0,
        )
        self.paces: list[_Pace | None] = [None] * len(self.jobs)
        self.reserved = 0.0

    def fill(self) -> int:
        """Render round after round; see ``render_within``."""
        self.reserved = self.reserve()
        units = max(1, self.kept + (self._left() > 0.0 and self.kept > 0))
        results = self._round(units, None)
        while True:
            self.reserved = self.reserve()
            more = self._affordable()
            if not more:
                break
            try:
                results = self._round(units + more, self.budget.seconds * OVERTIME_FRACTION)
            except _Late:
                break
            units += more
        for job, result in zip(self.jobs, results, strict=True):
            finished = replace(job, iterations=units * job.iterations)
            write_npz(self.folder / f"{finished.name}.npz", result.arrays())
        return units

    def _left(self) -> float:
        return self.budget.left() - self.reserved

    def _affordable(self) -> int:
        """Return how many units the next round adds; 0 when the time is used."""
        paces = [pace for pace in self.paces if pace is not None]
        if len(paces) < len(self.jobs):
            return 1 if self._left() > 0.0 else 0
        load = sum(pace.load for pace in paces)
        each = sum(p.each * job.iterations for p, job in zip(paces, self.jobs, strict=True))
        left = self._left()
        more = (left - load) / max(each, 1e-6)
        if more > LAST_UNITS and load < LOADING_FRACTION * left:
            return max(1, int(ROUND_FRACTION * more))
        # Half a unit too many is as good as half a unit too few. A pass that had to wait for its
        # kernel says little about the next one, and a round that comes late can be given up.
        least = int(left > 0.0 and not all(pace.clean for pace in paces))
        return max(least, round(more))

    def _round(self, units: int, overtime: float | None) -> list[RenderResult]:
        """Return the results of all jobs at ``units``; late by ``overtime`` s, it is given up."""
        results, took = [], []
        for index, job in enumerate(self.jobs):
            began = self.budget.clock()
            wanted = replace(job, iterations=units * job.iterations)
            state = self._state(job)
            # A job that goes on says first what it has loaded.
            resumed, times = state.exists(), [self.budget.clock()]

            def tick(_: int, times: list[float] = times) -> None:
                times.append(self.budget.clock())
                if self.progress is not None:
                    reserved = replace(self.budget, seconds=self.budget.seconds - self.reserved)
                    self.progress(reserved.progress())
                if overtime is not None and self._left() < -overtime:
                    raise _Late

            results.append(self.run(wanted, state, tick, keep=True))
            self._measure(index, times, self.budget.clock(), resumed=resumed)
            took.append(self.budget.clock() - began)
            if overtime is None:
                self._warn(took)
        return results

    def _warn(self, took: Sequence[float]) -> None:
        """Say so where the first jobs, of ``took`` s, show that all of them take too long."""
        first: dict[tuple[bool, bool], float] = {}
        again: dict[tuple[bool, bool], float] = {}
        for job, seconds in zip(self.jobs, took, strict=False):
            kind = job.indented, job.bend > 0
            (again if kind in first else first)[kind] = seconds
        part = COMPILED_FRACTION
        if again:
            part = sum(again.values()) / sum(first[kind] for kind in again)
        coming = 0.0
        for job in self.jobs[len(took) :]:
            kind = job.indented, job.bend > 0
            if kind not in first:
                first[kind] = max(first.values())
                coming += first[kind]
            else:
                coming += again.get(kind, part * first[kind])
        note = self.budget.warning(coming + self.reserved)
        if self.progress is not None and note:
            self.budget = self.budget.announcing(coming + self.reserved)
            self.progress(replace(self.budget.progress(), note=note))

    def _measure(self, index: int, times: list[float], end: float, *, resumed: bool) -> None:
        """Take the pace of a job from ``times``: its beginning, then every ``tick``.

        The first tick of a job that goes on is when it was loaded; the first pass of another has
        loading, and perhaps compiling, in it.
        """
        passes = [b - a for a, b in zip(times[resumed:], times[1 + resumed :], strict=False)]
        if not passes:
            return
        each = statistics.median(passes if resumed else passes[1:] or passes)
        load = max(end - times[0] - len(passes) * each, 0.0)
        self.paces[index] = _Pace(load, each, resumed or len(passes) > 1)

    def _state(self, job: RenderJob) -> Path:
        return self.folder / f"{job.name}.passes.npz"


Plan = TypeVar("Plan", bound="DataclassInstance")


def stored_plan(
    path: Path, kind: type[Plan], wanted: dict[str, Any], make: Callable[[], Plan]
) -> Plan:
    """Return the plan in ``path``, so that a resumed run renders the same, or make one and keep it.

    ``kind`` is a dataclass; a stored plan must agree with ``wanted``. ``make`` chooses what is
    rendered, perhaps by rendering it.
    """
    try:
        stored = kind(**read_json(path))
    except TypeError:
        stored = None
    if stored is not None and all(getattr(stored, key) == value for key, value in wanted.items()):
        return stored
    plan = make()
    write_json(path, asdict(plan))
    return plan
