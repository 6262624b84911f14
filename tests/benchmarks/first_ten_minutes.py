"""From a scene file to a verified design in ten minutes, of a cold cache: ``explore``, ``verify``.

``python -m tests.benchmarks.first_ten_minutes FOLDER 1 4 digit`` prints a row for each sensor and
keeps what it found in FOLDER, where it goes on; numbers are random sensors
(``tests.oracles.random_scenes``), names shipped scenes. Every sensor has a cache of its own, so
that nothing is known of it. Shipped scenes have models, and are explored on them.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from render.files import read_json, write_json
from tests.oracles.random_scenes import random_content, scene_text

ROOT = Path(__file__).parents[2]
FIRST = re.compile(
    r"First answer after ([0-9.]+) s.* score ([-0-9.]+) \(([-0-9.]+) to ([-0-9.]+)\)"
)


def said(words: list[str], folder: Path) -> tuple[dict[str, Any], str, float]:
    """Return what a command answers and says, and the seconds that it takes."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(folder / "cache")}
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "hw.cli", *words, "--json"], cwd=folder, env=environment,
        capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}: {done.stderr}")
    return json.loads(done.stdout), done.stderr, time.monotonic() - began


def verified(name: str, folder: Path, minutes: float) -> dict[str, Any]:
    """Return what is known of a sensor after so many minutes; kept in ``folder``."""
    kept = folder / "found.json"
    if kept.is_file():
        return read_json(kept)
    folder.mkdir(parents=True, exist_ok=True)
    scene = name
    if name.isdigit():
        scene = f"random-{name}.toml"
        (folder / scene).write_text(scene_text(random_content(int(name))), encoding="utf-8")
    found, words, spent = said(["explore", scene, "--out", "explored"], folder)
    # What has a model answers once.
    modeled = found["optimized"]["photon_noise"] is None
    first = None if modeled else FIRST.search(words)
    if first is None and not modeled:
        raise SystemExit(f"explore {scene} did not say when its first answer was there: {words}")
    left = minutes - spent / 60
    checked, _, more = said(
        ["verify", "explored/design.json", "--scene", scene, "--minutes", f"{left:.2f}"], folder
    )
    answer = {
        "first": None if first is None else [float(part) for part in first.groups()],
        "explored_seconds": spent,
        "explored": found,
        "verified": checked,
        "seconds": spent + more,
    }
    write_json(kept, answer)
    return answer


def row(name: str, found: dict[str, Any]) -> str:
    """Return a line of the table."""
    first, explored, checked = found["first"], found["explored"], found["verified"]
    score, gain = checked["design"], checked["difference"]
    cells = [
        f"random-{name}" if name.isdigit() else name,
        "model"
        if first is None
        else f"{first[0]:.0f} s: {first[1]:.0f} ({first[2]:.0f} to {first[3]:.0f})",
        f"{found['explored_seconds']:.0f} s: {explored['optimized']['score']:.1f} "
        f"({explored['optimized']['interval'][0]:.1f} to "
        f"{explored['optimized']['interval'][1]:.1f})",
        f"{score['score']:.1f} +- {score['se']:.1f}",
        f"{checked['baseline']['score']:.1f} +- {checked['baseline']['se']:.1f}",
        f"{gain['value']:.1f} [{gain['interval'][0]:.1f}, {gain['interval'][1]:.1f}]",
        "yes" if checked["converged"] else "no",
        f"{found['seconds']:.0f} s",
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the table of the sensors that are named."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("sensors", nargs="+")
    parser.add_argument("--minutes", type=float, default=10.0)
    asked = parser.parse_args()
    print("| sensor | first answer | explored | verified | baseline | gain | converged | all |")
    print("|---|---|---|---|---|---|---|---|")
    for name in asked.sensors:
        found = verified(name, asked.folder.resolve() / name, asked.minutes)
        print(row(name, found), flush=True)


if __name__ == "__main__":
    main()
