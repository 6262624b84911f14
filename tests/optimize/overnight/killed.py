"""Kills runs at random instants, for real, and says how that went: a program for a test to start.

Every second kill waits for the attempt to have written a few states before it takes its instant,
so that kills come while a render is under way on a machine of any speed.

A process forks one attempt after the other. It has imported everything and has used none of it, so
an attempt begins within milliseconds and no thread of Dr.Jit is lost by the fork.

Usage: killed.py FOLDER KILLS SEED
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import sys
import time
from pathlib import Path
from typing import NamedTuple

from optimize.overnight.store import STATES
from render.reference import mitsuba
from render.scene import Scene
from tests.optimize.overnight.attempt import attempt
from tests.optimize.overnight.tiny import tiny_scene

LONGEST = 0.4
"""An attempt lives at most so long, in units of what an unbroken run takes here."""


MOST_STATES = 12
"""A kill that waits for states waits for so many at most; a render writes sixteen."""


class Instant(NamedTuple):
    """When an attempt is killed: so many seconds after it began or wrote its last of ``states``."""

    states: int
    seconds: float


def state_of(run: Path) -> set[tuple[str, int]]:
    """Return the states that a run has now, each with the instant at which it was written."""
    found = set()
    for path in (run / STATES).glob("*.npz"):
        with contextlib.suppress(FileNotFoundError):
            found.add((path.name, path.stat().st_mtime_ns))
    return found


def forked(run: Path, scene: Scene, kill: Instant | None) -> bool:
    """Run an attempt in a process of its own; kill it at an instant, or let it end."""
    child = os.fork()
    if not child:
        try:
            attempt(run, scene)
        except BaseException as error:
            print(repr(error), file=sys.stderr, flush=True)
            os._exit(1)
        os._exit(0)
    began, seen, left = time.monotonic(), state_of(run), kill.states if kill else 0
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            if os.waitstatus_to_exitcode(status):
                raise SystemExit(f"an attempt failed: {os.waitstatus_to_exitcode(status)}")
            return True
        if left and (now := state_of(run)) - seen:
            began, seen, left = time.monotonic(), now, left - 1
        if kill and not left and time.monotonic() - began >= kill.seconds:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return False
        time.sleep(0.001)


def main() -> None:
    """Kill until the kills are used up; after a run that finishes meanwhile, another begins."""
    folder, kills, rng = Path(sys.argv[1]), int(sys.argv[2]), random.Random(int(sys.argv[3]))
    mitsuba()
    scene = tiny_scene(folder)
    killed = resumed = 0
    broken: list[str] = []
    (folder / "unbroken").mkdir()
    began = time.monotonic()
    forked(folder / "unbroken", scene, None)
    longest = LONGEST * (time.monotonic() - began)
    while True:
        run = folder / f"broken-{len(broken)}"
        run.mkdir()
        broken.append(run.name)
        while killed < kills:
            states = rng.randint(1, MOST_STATES) if killed % 2 else 0
            # From one state to the next is a small part of a run.
            within = longest / 50 if states else longest
            if forked(run, scene, Instant(states, rng.uniform(0.0, within))):
                break
            killed += 1
            resumed += any((run / STATES).glob("*.npz")) if (run / STATES).is_dir() else 0
        if killed == kills:
            forked(run, scene, None)
            break
    print(json.dumps({"killed": killed, "resumed": resumed, "broken": broken}))


if __name__ == "__main__":
    main()
