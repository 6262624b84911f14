"""Resident memory of a night stays flat: what one render needs, the next one uses again."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from optimize.overnight.status import status_of
from optimize.overnight.store import Store
from optimize.overnight.workers import LocalWorker, StoredRenders
from optimize.ui.process import Signals
from render.progress import Clock
from render.reference import transport_jobs
from tests.optimize.overnight.tiny import request_of, tiny_scene
from tests.validation.film import LONG

EVALUATIONS = 1000 if LONG else 60
NODES = (1, 2, 3, 5)
"""Directions per fiber of one render: rounds of a night differ in them, and so do their kernels."""
SETTLED = 0.4
"""Part of the run after which everything has been used once."""
GROWTH = 0.05
"""Relative growth after that which still counts as flat."""


def resident() -> int:
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def test_resident_memory_is_flat_over_many_evaluations(tmp_path: Path) -> None:
    scene = tiny_scene(tmp_path)
    rng = np.random.default_rng(3)
    found: list[int] = []
    store = Store(tmp_path, request_of(scene), lambda text: None)
    runner = StoredRenders(store, LocalWorker(), Signals())
    while len(found) < EVALUATIONS:
        nodes = NODES[len(found) // 2 % len(NODES)]
        phi = rng.uniform(0.5, 2.6, (scene.lamp_count, nodes))
        jobs = transport_jobs(
            scene, phi, np.array([0.0]), samples=4, seeds=[len(found)], replicates=4
        )
        runner(jobs, Clock(sum(job.samples for job in jobs), None))
        found += [resident()] * len(jobs)
    count = status_of(tmp_path).evaluations
    store.close("finished")
    assert count >= EVALUATIONS
    settled = found[int(SETTLED * len(found))]
    print(
        f"{count} evaluations: {found[0] / 2**20:.0f} MiB after the first, "
        f"{settled / 2**20:.0f} after {SETTLED:.0%} of them, {found[-1] / 2**20:.0f} at the end"
    )
    assert found[-1] < (1 + GROWTH) * settled
