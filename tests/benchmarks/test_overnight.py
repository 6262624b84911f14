"""The bounds of a night: what logging and scheduling add, and how soon a killed run goes on."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from optimize.overnight.run_directory import RECORD
from optimize.overnight.store import STATES, Store
from optimize.overnight.workers import FinishedJob, LocalWorker, StoredRenders
from optimize.ui.process import Signals
from render.chebyshev import chebyshev_nodes
from render.progress import Clock
from render.reference import RenderJob, transport_jobs
from render.scene import load_scene
from tests.optimize.overnight.tiny import rows, start

SAMPLES = 40
"""Per cell: renders of one to three seconds on two cores, as short as those of a short night."""
OVERHEAD, RESUME = 0.02, 10.0


class Timed:
    """Renders here and notes how long that takes, without what the runner does in between."""

    count = 1

    def __init__(self) -> None:
        self.seconds = 0.0

    def render(
        self,
        jobs: Sequence[RenderJob],
        state: Callable[[RenderJob], Path],
        tick: Callable[[int], None],
    ) -> Iterator[FinishedJob]:
        def outside(count: int) -> None:
            self.seconds += time.perf_counter()
            tick(count)
            self.seconds -= time.perf_counter()

        rendered = LocalWorker().render(jobs, state, outside)
        while True:
            self.seconds -= time.perf_counter()
            done = next(rendered, None)
            self.seconds += time.perf_counter()
            if done is None:
                return
            yield done

    def close(self) -> None:
        """Nothing was started."""


def test_what_logging_and_scheduling_add_to_renders(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    scene = load_scene("finger20")
    phi, bends = chebyshev_nodes(11, 0.0, np.pi), np.array(scene.bending.angles)
    jobs = transport_jobs(scene, phi, bends, samples=SAMPLES, seeds=[1])
    store = Store(tmp_path, {"--samples": SAMPLES}, lambda text: None)
    workers = Timed()
    runner = StoredRenders(store, workers, Signals())
    began = time.perf_counter()
    results = runner(jobs, Clock(sum(job.samples for job in jobs), None))
    added = time.perf_counter() - began - workers.seconds
    store.close("finished")
    assert len(results) == len(jobs)
    with capsys.disabled():
        print(
            f"\nlogging and scheduling of {len(jobs)} renders of {workers.seconds / len(jobs):.1f} "
            f"s: {added / len(jobs) * 1e3:.1f} ms each, {added / workers.seconds:.2%} of render "
            f"time, {added / workers.seconds / OVERHEAD:.2f} of the allowed {OVERHEAD:.0%}"
        )


def logged(run: Path) -> int:
    return len(rows(run, "SELECT key FROM evaluations")) if (run / RECORD).exists() else 0


def test_a_killed_night_renders_again_soon(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    words = "overnight", "finger20", "--out", tmp_path, "--samples", 256
    first = start(*words)
    while logged(tmp_path) < 3:
        assert first.poll() is None
        time.sleep(0.1)
    first.send_signal(signal.SIGKILL)
    first.communicate()
    before = logged(tmp_path)
    for state in (tmp_path / STATES).iterdir():
        state.unlink()
    began = time.perf_counter()
    again = start(*words, "--json-lines")
    # What is told first are the renders that are there; more than them are new paths.
    assert again.stdout is not None
    done = []
    for event in map(json.loads, again.stdout):
        if event["event"] == "progress" and event["stage"] == "Transport table":
            done.append(event["done"])
            if done[-1] > done[0]:
                break
    seconds = time.perf_counter() - began
    again.kill()
    again.communicate()
    assert len(set(done)) == 2
    assert logged(tmp_path) >= before
    with capsys.disabled():
        print(f"\na killed night renders again after {seconds:.1f} s, "
              f"{seconds / RESUME:.2f} of the allowed {RESUME:g} s")  # fmt: skip
