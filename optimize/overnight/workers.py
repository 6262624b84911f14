"""Who renders: this process, or workers of Dask.distributed on this machine or on others.

A job travels as text and its result comes back as an array in memory (a few MB per many seconds of
rendering): machines need no common file system, and only one process ever writes to the run
directory, so that a worker that was given up as lost cannot disturb it later.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from render.reference.job import PadJob, PadResult, render_pad


@dataclass(frozen=True, eq=False)
class FinishedJob:
    """A finished job: its place among those asked for, its result, and who rendered it."""

    index: int
    result: PadResult
    worker: str


class Workers(Protocol):
    """Renders jobs, at several places at once where there are some."""

    @property
    def count(self) -> int:
        """How many jobs are rendered at once."""

    def render(
        self,
        jobs: Sequence[PadJob],
        state: Callable[[PadJob], Path],
        tick: Callable[[int], None],
    ) -> Iterator[FinishedJob]:
        """Yield the results as they come, in any order.

        Arguments:
            jobs: what is rendered.
            state: where an unfinished job can be kept.
            tick: told of samples as they are made; called every second at least while waiting.
        """

    def close(self) -> None:
        """End what was started."""


class LocalWorker:
    """This process, one job after the other on all its cores; unfinished jobs go on later."""

    count = 1

    def render(
        self,
        jobs: Sequence[PadJob],
        state: Callable[[PadJob], Path],
        tick: Callable[[int], None],
    ) -> Iterator[FinishedJob]:
        """Yield the results in order."""
        for index, job in enumerate(jobs):
            result = render_pad(job, state(job), tick)
            # Dr.Jit 1.5 can stop with "invalid redefinition of function" while dead scenes linger.
            gc.collect()
            yield FinishedJob(index, result, "here")

    def close(self) -> None:
        """Nothing was started."""
