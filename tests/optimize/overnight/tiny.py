"""A sensor so small that a render takes a third of a second: what a run survives is not its size.

Used by tests and by the processes that tests start and kill.
"""

from __future__ import annotations

import hashlib
import os
import signal
import sqlite3
import subprocess
import sys
from importlib import resources
from pathlib import Path
from typing import IO

import numpy as np

from optimize.overnight.result import DESIGNS, NIGHT
from optimize.overnight.run_directory import RECORD
from optimize.overnight.store import RENDERS, Request
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


def request_of(scene: Scene) -> Request:
    """Return what a run of ``scene`` with a fixed amount of work is for."""
    return {"the scene of hash": scene.hash, "--seed": 0, "--samples": 8}


def command(*words: object) -> list[str]:
    """Return the command line of the program."""
    return [sys.executable, "-m", "hw.cli", *map(str, words)]


def start(*words: object, output: IO[str] | None = None) -> subprocess.Popen[str]:
    """Start the program in a process of its own; what it says goes into pipes, or to ``output``."""
    to = subprocess.PIPE if output is None else output
    return subprocess.Popen(
        command(*words), cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=to,
        stderr=to, text=True,
        # Tests that were started in the background would hand on that SIGINT is ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip


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


def outcome(run: Path) -> dict[str, object]:
    """Return the SHA-256 of everything of a run that no clock has a part in, and what it logged."""
    files = [NIGHT, "model/checker.onnx", "model/golden.npz", "table/reference.npz", "scene.toml"]
    files += [f"{DESIGNS}/{path.name}" for path in sorted((run / DESIGNS).iterdir())]
    files += [f"{RENDERS}/{path.name}" for path in sorted((run / RENDERS).iterdir())]
    decisions = rows(run, "SELECT name, value FROM decisions ORDER BY name")
    return {
        **{name: hashlib.sha256((run / name).read_bytes()).hexdigest() for name in files},
        "decisions": [r for r in decisions if not str(r[0]).startswith("finished")],
        "evaluations": rows(run, "SELECT key, sha256 FROM evaluations ORDER BY key"),
    }
