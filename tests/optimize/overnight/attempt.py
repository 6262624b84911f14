"""One attempt at a run of four small renders: what tests kill, starve and interrupt.

Usage: attempt.py RUN FOLDER, with the tiny scene in FOLDER.
"""

from __future__ import annotations

import sys
from pathlib import Path

import render.reference.job
from optimize.overnight.run_directory import RunError, locked, writing
from optimize.overnight.store import Store
from optimize.overnight.workers import LocalWorker, StoredRenders
from optimize.ui.process import Signals
from render.progress import Clock
from render.scene import Scene, load_scene
from tests.optimize.overnight.tiny import request_of, tiny_jobs

SEEDS = 2


def attempt(run: Path, scene: Scene) -> None:
    """Begin the run, or go on with it; its state is kept after every eight samples."""
    render.reference.job.SAVE_SECONDS = 0.0
    with writing(run), locked(run):
        store = Store(run, request_of(scene), lambda text: print(text, file=sys.stderr))
        try:
            jobs = tiny_jobs(scene, SEEDS)
            renders = StoredRenders(store, LocalWorker(), Signals())
            renders.kind = "1/table"
            seeds = store.decide("seeds", lambda: [job.seed for job in jobs])
            assert seeds == [job.seed for job in jobs]
            renders(jobs, Clock(sum(job.samples for job in jobs), None))
        finally:
            store.close("stopped")


if __name__ == "__main__":
    try:
        attempt(Path(sys.argv[1]), load_scene(Path(sys.argv[2]) / "tiny.toml"))
    except RunError as error:
        print(error)
        sys.exit(2)
