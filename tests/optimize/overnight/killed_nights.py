"""Kills a whole night of the tiny sensor again and again, for real, and says what that cost.

Every attempt is a new process that imports all it needs, as a user's is. Lifetimes are drawn evenly
from nothing to twice the mean. Seconds are those of the processor that an attempt has
used: on a machine with nothing else to do they are those on the wall.

Usage: killed_nights.py FOLDER SEED MEAN_LIFE
"""

from __future__ import annotations

import json
import math
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.optimize.overnight.tiny import start, write_tiny

SAMPLES = 8
MAX_ATTEMPTS = 60


def used(process: subprocess.Popen[str]) -> float:
    """Return the processor seconds of all threads of a process that runs."""
    fields = (
        Path(f"/proc/{process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    )
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def attempt(scene: Path, run: Path, life: float) -> tuple[bool, float]:
    """Let an attempt live for ``life`` seconds; return whether it ended itself, and its seconds."""
    with run.with_suffix(".txt").open("a", encoding="utf-8") as said:
        process = start("overnight", scene, "--out", run, "--samples", SAMPLES, output=said)
    seconds = 0.0
    while process.poll() is None:
        try:
            seconds = used(process)
        except (FileNotFoundError, ProcessLookupError):
            continue
        if seconds >= life:
            process.send_signal(signal.SIGKILL)
            process.wait()
            return False, seconds
        time.sleep(0.01)
    if process.returncode:
        raise SystemExit(f"an attempt failed: {run.with_suffix('.txt').read_text()}")
    return True, seconds


def main() -> None:
    """Run an unbroken night and one that is killed; print their seconds and the lives as JSON."""
    folder, rng, mean = Path(sys.argv[1]), random.Random(int(sys.argv[2])), float(sys.argv[3])
    scene = write_tiny(folder)
    _, unbroken = attempt(scene, folder / "unbroken", math.inf)
    lives: list[float] = []
    done = False
    while not done and len(lives) < MAX_ATTEMPTS:
        done, seconds = attempt(scene, folder / "broken", rng.uniform(0.0, 2.0) * mean)
        lives.append(seconds)
    print(json.dumps({"done": done, "unbroken": unbroken, "broken": sum(lives), "lives": lives}))


if __name__ == "__main__":
    main()
