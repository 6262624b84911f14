"""Who renders: this process, or workers of Dask.distributed on this machine or on others.

A job travels as text and its result comes back as an array in memory (a few MB per many seconds of
rendering): machines need no common file system, and only one process ever writes to the run
directory, so that a worker that was given up as lost cannot disturb it later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from optimize.overnight.store import Store
from optimize.ui.process import Signals
from render.progress import Clock
from render.reference import RenderJob, RenderResult, run_job

State = Callable[[RenderJob], Path]
"""Where an unfinished job can be kept."""
Tick = Callable[[int], None]
"""Told of samples as they are made, and called every second at least while waiting."""


@dataclass(frozen=True, eq=False)
class FinishedJob:
    """A finished job: its place among those asked for, its result, and who rendered it."""

    index: int
    result: RenderResult
    worker: str


class Workers(Protocol):
    """Renders jobs, at several places at once where there are some."""

    @property
    def count(self) -> int:
        """How many jobs are rendered at once."""

    def render(self, jobs: Sequence[RenderJob], state: State, tick: Tick) -> Iterator[FinishedJob]:
        """Yield the results of ``jobs`` as they come, in any order."""

    def close(self) -> None:
        """End what was started."""


class LocalWorker:
    """This process, one job after the other on all its cores; unfinished jobs go on later."""

    count = 1

    def render(self, jobs: Sequence[RenderJob], state: State, tick: Tick) -> Iterator[FinishedJob]:
        """Yield the results in order."""
        for index, job in enumerate(jobs):
            result = run_job(job, state(job), tick)
            yield FinishedJob(index, result, "here")

    def close(self) -> None:
        """Nothing was started."""


class OutOfTime(Exception):
    """The time for a stage is over; what it has rendered so far is kept."""


class StoredRenders:
    """Runs jobs for ``render_transport``; every result is kept before the next is waited for.

    ``kind`` says what renders are for and goes into the record; where ``deadline`` is set, renders
    stop when so many seconds are worked.
    """

    def __init__(self, store: Store, workers: Workers, signals: Signals) -> None:
        self.store, self.workers, self.signals = store, workers, signals
        self.kind = ""
        self.deadline: float | None = None

    @contextmanager
    def until(self, deadline: float | None) -> Iterator[None]:
        """Let renders inside the block stop at ``deadline``, in seconds of ``Store.spent``."""
        self.deadline = deadline
        try:
            yield
        finally:
            self.deadline = None

    def __call__(self, jobs: Sequence[RenderJob], clock: Clock) -> list[RenderResult]:
        """Return the results in the order of ``jobs``.

        Raises:
            OutOfTime: the deadline has come.
            Stopped: a signal asked for the end.
        """
        found: dict[str, RenderResult | None] = {}
        for job in jobs:
            if job.key not in found:
                found[job.key] = self.store.finished(job)
                if found[job.key] is not None:
                    clock.skip(job.samples)
        missing = {job.key: job for job in jobs if found[job.key] is None}
        todo = list(missing.values())
        with self.signals.patient() as stop_if_asked:

            def tick(count: int) -> None:
                clock.tick(count)
                self.store.beat()
                stop_if_asked()
                if self.deadline is not None and self.store.spent() > self.deadline:
                    raise OutOfTime

            for done in self.workers.render(todo, self.store.state, tick):
                job = todo[done.index]
                self.store.keep(job, done.result, self.kind, done.worker)
                found[job.key] = done.result
        return [result for job in jobs if (result := found[job.key]) is not None]
