"""A sensor so small that a render takes a third of a second: what a run survives is not its size.

Used by tests and by the processes that tests start and kill.
"""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
from importlib import resources
from pathlib import Path

import numpy as np

from optimize.overnight.run_directory import RECORD
from optimize.overnight.store import RunRequest
from render.reference import RenderJob, transport_jobs
from render.scene import Scene, load_scene

ROOT = Path(__file__).parents[3]
CHANGES = {
    'name = "finger20"': 'name = "tiny"',
    "left = 8\ntip = 4\nright = 8": "left = 2\ntip = 1\nright = 2",
    "[0.0, 45.0, 90.0]": "[0.0]",
    "columns = 3\nrows = 5": "columns = 1\nrows = 2",
    "faces = 10": "faces = 4",
}


def write_tiny(folder: Path) -> Path:
    """Return the file of a sensor with 5 fibers, 2 sites, 4 facets and one bend."""
    text = (resources.files("render") / "scenes" / "finger20.toml").read_text(encoding="utf-8")
    for old, new in CHANGES.items():
        assert old in text
        text = text.replace(old, new)
    path = folder / "tiny.toml"
    path.write_text(text, encoding="utf-8")
    return path


def tiny_jobs(scene: Scene, seeds: int, iterations: int = 16) -> list[RenderJob]:
    """Return two jobs per seed, each of some chunks."""
    phi, bends = np.array([np.pi / 2]), np.array([0.0])
    jobs = transport_jobs(
        scene, phi, bends, samples=4, seeds=list(range(1, seeds + 1)), replicates=4
    )
    return [RenderJob(**{**vars_of(job), "iterations": iterations}) for job in jobs]


def vars_of(job: RenderJob) -> dict[str, object]:
    """Return the fields of a job."""
    return {name: getattr(job, name) for name in RenderJob.__dataclass_fields__}


def request_of(scene: Scene) -> RunRequest:
    """Return what a run of ``scene`` with a fixed amount of work is for."""
    return RunRequest(scene.hash, "", 0, 8)


def command(*words: object) -> list[str]:
    """Return the command line of the program."""
    return [sys.executable, "-m", "hw.cli", *map(str, words)]


def start(*words: object, **options: object) -> subprocess.Popen[str]:
    """Start the program in a process of its own."""
    return subprocess.Popen(
        command(*words),
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,  # type: ignore[call-overload]
    )


def tiny_scene(folder: Path) -> Scene:
    """Return the scene of ``write_tiny``."""
    return load_scene(write_tiny(folder))


def rows(run: Path, query: str) -> list[tuple[object, ...]]:
    """Return what the record of ``run`` answers."""
    db = sqlite3.connect(run / RECORD)
    try:
        return db.execute(query).fetchall()
    finally:
        db.close()
