"""Kills a command on the tiny sensor again and again, for real, and says what that cost.

Nothing is in the cache when it begins. Every attempt is a new process that imports all it needs, as
a user's is. Lifetimes are drawn evenly from nothing to twice the mean. Seconds are those of the
processor that an attempt has used: on a machine with nothing else to do they are those on the wall.

Usage: killed_commands.py COMMAND FOLDER SEED MEAN_LIFE
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

from tests.optimize.overnight.commands import words_of
from tests.optimize.overnight.tiny import start, write_tiny

MAX_ATTEMPTS = 60


def used(process: subprocess.Popen[str]) -> float:
    """Return the processor seconds of all threads of a process that runs."""
    fields = (
        Path(f"/proc/{process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    )
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def attempt(name: str, scene: Path, folder: Path, life: float) -> tuple[bool, float]:
    """Let an attempt live for ``life`` seconds; return whether it ended itself, and its seconds."""
    os.environ["XDG_CACHE_HOME"] = str(folder / "cache")
    with folder.with_suffix(".txt").open("a", encoding="utf-8") as said:
        process = start(*words_of(name, scene, folder), output=said)
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
        raise SystemExit(f"an attempt failed: {folder.with_suffix('.txt').read_text()}")
    return True, seconds


def main() -> None:
    """Run a command unbroken and killed; print the seconds of both and the lives as JSON."""
    name, folder, rng, mean = (
        sys.argv[1], Path(sys.argv[2]), random.Random(int(sys.argv[3])), float(sys.argv[4])
    )  # fmt: skip
    scene = write_tiny(folder)
    _, unbroken = attempt(name, scene, folder / "unbroken", math.inf)
    lives: list[float] = []
    done = False
    while not done and len(lives) < MAX_ATTEMPTS:
        done, seconds = attempt(name, scene, folder / "broken", rng.uniform(0.0, 2.0) * mean)
        lives.append(seconds)
    print(json.dumps({"done": done, "unbroken": unbroken, "broken": sum(lives), "lives": lives}))


if __name__ == "__main__":
    main()
