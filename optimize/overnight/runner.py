"""The night's runner: looks jobs up in the store and renders only what is missing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from optimize.overnight.run_log import Signals
from optimize.overnight.store import Store
from optimize.overnight.workers import Workers
from render.progress import Clock
from render.reference.job import PadJob, PadResult


class OutOfTime(Exception):
    """The time for a stage is over; what it has rendered so far is kept."""


class StoredRenders:
    """Runs jobs for ``render_transport``; every result is kept before the next is waited for.

    ``kind`` says what renders are for and goes into the record; where ``deadline`` is set, renders
    stop when so many seconds are worked.

    Arguments:
        store: the run directory.
        workers: who renders.
        signals: asked between samples whether to stop.
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

    def __call__(self, jobs: Sequence[PadJob], clock: Clock) -> list[PadResult]:
        """Return the results in the order of ``jobs``.

        Raises:
            OutOfTime: the deadline has come.
            Stopped: a signal asked for the end.
        """
        found: dict[str, PadResult] = {}
        missing: dict[str, PadJob] = {}
        for job in jobs:
            if job.key in found or job.key in missing:
                continue
            known = self.store.finished(job, self.kind)
            if known is None:
                missing[job.key] = job
            else:
                found[job.key] = known
                clock.skip(job.samples)
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
        return [found[job.key] for job in jobs]
