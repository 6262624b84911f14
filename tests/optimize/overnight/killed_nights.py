"""Kills a whole night of the tiny sensor again and again, for real, and says how long it took.

Every attempt is a new process that imports all it needs, as a user's is. Lifetimes are drawn evenly
from 0 to twice the mean, which is a given part of what the unbroken night takes here: 10 s where
that takes half a minute.

Usage: killed_nights.py FOLDER SEED
"""

from __future__ import annotations

import json
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.optimize.overnight.tiny import start, write_tiny

MEAN_LIFE = 1 / 3
"""Mean lifetime of an attempt, in units of the unbroken night."""
SAMPLES = 8
MAX_ATTEMPTS = 100


def attempt(scene: Path, run: Path, life: float | None) -> bool:
    """Let one attempt live for ``life`` seconds, or to its end; return whether it came there."""
    process = start("overnight", scene, "--out", run, "--samples", SAMPLES)
    try:
        _, said = process.communicate(timeout=life)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.communicate()
        return False
    if process.returncode:
        raise SystemExit(f"an attempt failed: {said}")
    return True


def main() -> None:
    """Run an unbroken night and one that is killed; print seconds and attempts as JSON."""
    folder, rng = Path(sys.argv[1]), random.Random(int(sys.argv[2]))
    scene = write_tiny(folder)
    # Once for the caches of compiled kernels, which every night after the first one finds.
    attempt(scene, folder / "first", None)
    shutil.rmtree(folder / "first")
    began = time.monotonic()
    attempt(scene, folder / "unbroken", None)
    unbroken = time.monotonic() - began
    lives: list[float] = []
    began = time.monotonic()
    while len(lives) < MAX_ATTEMPTS:
        lives.append(rng.uniform(0.0, 2 * MEAN_LIFE * unbroken))
        if attempt(scene, folder / "broken", lives[-1]):
            break
    broken = time.monotonic() - began
    print(json.dumps({"unbroken": unbroken, "broken": broken, "attempts": len(lives)}))


if __name__ == "__main__":
    main()
