"""Nights in a simulated world: the engine is the real one, and renders take no time.

The record, the steps of a night, its runner of renders and its client of Dask are those of the
program. The world around them follows from one integer: what a render finds and how long it seems
to take, kills between any two syncs, renames and looks at the clock, workers that are lost, late or
asked twice, clocks that jump, files that are damaged between attempts, and disks that are full.

Usage: simulated_nights.py FIRST COUNT
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import random
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np

from optimize.overnight.context import RunContext
from optimize.overnight.dask_workers import DaskWorkers
from optimize.overnight.run_directory import RunError, check_run_directory, locked, writing
from optimize.overnight.run_log import RunLog
from optimize.overnight.store import RENDERS, Store
from optimize.overnight.workers import StoredRenders
from optimize.ui.process import Signals
from render.progress import Clock
from render.reference import RenderJob, RenderResult
from render.scene import Scene
from tests.optimize.overnight.tiny import rows, tiny_jobs, tiny_scene

STAGES = (("table pass", 0.4), ("round", 0.76), ("final batch", 1.0))
"""Steps of a night, and the part of its time by which they end."""
STEPS, HOURS = 3, 0.2
MOST_ATTEMPTS = 60


class Killed(BaseException):
    """The process is no more: nothing that it does later reaches the disk."""


class World:
    """All that is not the program's own, by one integer; ``calm`` is one in which nothing is wrong.

    ``now`` are the seconds that seem to have passed.
    """

    def __init__(self, number: int, *, calm: bool = False) -> None:
        self.random, self.calm, self.now = random.Random(number), calm, 1000.0
        self.dead = False
        self.left = math.inf
        self.full = math.inf

    def begin_attempt(self) -> None:
        """Draw when this attempt is killed and when the disk is full, in steps of the world."""
        self.dead, self.left, self.full = False, math.inf, math.inf
        if self.calm:
            return
        # Clocks of another start begin anywhere.
        self.now = self.random.uniform(0.0, 1e6)
        if self.random.random() < 0.8:
            self.left = self.random.randrange(400)
        if self.random.random() < 0.2:
            self.full = self.random.randrange(60)

    def step(self) -> None:
        """Let something happen."""
        self.left -= 1
        if self.dead or self.left < 0:
            self.dead = True
            raise Killed

    def monotonic(self) -> float:
        """Return the seconds of a clock that only this process looks at."""
        self.step()
        self.now += 1e-3
        return self.now

    def change(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """Return what changes the disk, if there is room, as long as the process lives."""

        def changed(*words: Any, **named: Any) -> Any:
            self.step()
            self.full -= 1
            if self.full < 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return call(*words, **named)

        return changed

    @contextmanager
    def around(self) -> Iterator[None]:
        """Put the program into this world; what it syncs is synced for it."""
        with (
            patch("time.monotonic", self.monotonic),
            patch("time.time", lambda: self.random.uniform(0.0, 2e9)),
            patch("os.fsync", self.change(lambda _: None)),
            patch("os.replace", self.change(os.replace)),
            patch("os.unlink", self.alive(os.unlink)),
            patch("pathlib.Path.unlink", self.alive(Path.unlink)),
        ):
            yield

    def alive(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """Return what a killed process no longer does."""

        def called(*words: Any, **named: Any) -> Any:
            if self.dead:
                raise Killed
            return call(*words, **named)

        return called

    def damage(self, run: Path) -> None:
        """Turn a bit of a finished render, now and then."""
        files = sorted((run / RENDERS).glob("*.npz")) if (run / RENDERS).is_dir() else []
        if files and not self.calm and self.random.random() < 0.2:
            path = self.random.choice(files)
            content = bytearray(path.read_bytes())
            content[self.random.randrange(len(content))] ^= 1 << self.random.randrange(8)
            path.write_bytes(content)


@dataclass
class SimulatedFuture:
    """What a scheduler gives for a job: it may be late, and its worker may be lost meanwhile."""

    world: World
    job: RenderJob
    late: int

    @property
    def key(self) -> str:
        """A name that no other job has."""
        return self.job.key

    def add_done_callback(self, arrived: Callable[[Any], None]) -> None:
        """Tell of it; with others that come first, see `SimulatedClient`."""
        arrived(self)

    def result(self, timeout: float) -> tuple[dict[str, np.ndarray], str]:
        """Return the render, of a worker that is asked again where one was lost."""
        self.world.now += self.world.random.uniform(0.1, timeout if self.late else 20.0)
        if self.late:
            self.late -= 1
            raise TimeoutError
        return simulated_render(self.job).arrays(), "somewhere"

    def cancel(self) -> None:
        """It is not needed."""


class SimulatedClient:
    """A scheduler with workers that cannot be relied upon."""

    def __init__(self, world: World) -> None:
        self.world = world

    def submit(
        self, _render: object, text: str, _key: str, _threads: int | None, **_options: object
    ) -> SimulatedFuture:
        """Return what will bring a job's render."""
        late = 0 if self.world.calm else self.world.random.choice((0, 0, 1, 3))
        return SimulatedFuture(self.world, RenderJob.from_json(text), late)


class SimulatedWorkers(DaskWorkers):
    """The program's own client of Dask, in front of `SimulatedClient`."""

    count = 2

    def __init__(self, world: World) -> None:
        self.client, self.cluster, self.threads = SimulatedClient(world), None, None

    def close(self) -> None:
        """Nothing was started."""


def simulated_render(job: RenderJob) -> RenderResult:
    """Return a render that follows from its job."""
    random = np.random.default_rng(int(job.key[:12], 16))
    return RenderResult(random.random((2, 5, 1, 4)), random.random((5, 1, 4)), 1.0)


def attempt(world: World, scene: Scene, run: Path, samples: int | None) -> str:
    """Work at a night until it ends or is ended; return what it has found."""
    found = hashlib.sha256()
    check_run_directory(run)
    with writing(run):
        run.mkdir(exist_ok=True)
        with locked(run), closing(RunLog(run, None)) as log:
            store = Store(run, {"--seed": 0, "--samples": samples}, lambda _: None)
            try:
                context = RunContext(
                    scene=scene, store=store, log=log, seed=0, objective="score", number=1,
                    renders=StoredRenders(store, SimulatedWorkers(world), Signals()),
                    extension=0, samples=samples, began=0.0,
                    until=math.inf if samples else 3600 * HOURS,
                )  # fmt: skip
                for purpose, (name, until) in enumerate(STAGES):
                    _steps(context, name, purpose, until, found)
                return str(store.decide("finished 0", found.hexdigest))
            finally:
                store.close("stopped")


@cache
def jobs_of(scene: Scene) -> list[RenderJob]:
    """Return the pads of a step."""
    return tiny_jobs(scene, 1)


def _steps(
    context: RunContext, name: str, purpose: int, until: float, found: hashlib._Hash
) -> None:
    """Take the steps of a stage; each depends on all renders before it, as proposals do."""

    def plan(number: int, longest: float) -> dict[str, Any]:
        if number > STEPS or longest / 2 > context.seconds_until(until):
            return {"stop": "enough"}
        return {"seed": context.random_seed(purpose, number), "after": found.hexdigest()}

    def work(_number: int, decided: dict[str, Any]) -> None:
        assert decided["after"] == found.hexdigest()
        jobs = [replace(job, seed=decided["seed"]) for job in jobs_of(context.scene)]
        for result in context.renders(jobs, Clock(sum(job.samples for job in jobs), None)):
            found.update(result.estimate.tobytes())

    late = context.deadline(until + 0.04) if context.samples is None else math.inf
    context.steps(name, plan, work, late)


def simulated_night(number: int, scene: Scene, run: Path, *, calm: bool = False) -> tuple[str, int]:
    """Work at night ``number`` until it is finished; return what it found, and the attempts.

    Even numbers are nights of so many samples, odd ones of hours.
    """
    shutil.rmtree(run, ignore_errors=True)
    world, samples = World(number, calm=calm), None if number % 2 else 8
    for attempts in range(1, MOST_ATTEMPTS):
        world.begin_attempt()
        try:
            with world.around():
                found = attempt(world, scene, run, samples)
        except Killed:
            world.damage(run)
            continue
        except RunError as error:
            if "free some space" not in str(error):
                raise
            continue
        logged = rows(run, "SELECT DISTINCT key, sha256 FROM evaluations")
        assert len(logged) == len({key for key, _ in logged}), "one job, two results"
        return found, attempts
    raise AssertionError(f"night {number} does not end")


def main() -> None:
    """Simulate nights one after the other; print how many, and processor seconds, as JSON."""
    first, count, attempts = int(sys.argv[1]), int(sys.argv[2]), 0
    # In memory, where there is such a place: what SQLite syncs is not what is tried here.
    memory = Path("/dev/shm")
    with TemporaryDirectory(dir=memory if os.access(memory, os.W_OK) else None) as name:
        folder = Path(name)
        scene, began = tiny_scene(folder), time.process_time()
        wanted, _ = simulated_night(0, scene, folder / "calm", calm=True)
        for number in range(first, first + count):
            found, more = simulated_night(number, scene, folder / "night")
            assert number % 2 or found == wanted, number
            if number % 20 == 1:  # of hours: one integer is one night
                assert simulated_night(number, scene, folder / "night") == (found, more), number
            attempts += more
    seconds = time.process_time() - began
    print(json.dumps({"nights": count, "attempts": attempts, "seconds": seconds}))


if __name__ == "__main__":
    main()
