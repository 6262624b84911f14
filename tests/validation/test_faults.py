"""Random commands under random faults: documented exit codes, no traceback, nothing half done."""

from __future__ import annotations

import json
import random
import shutil
from pathlib import Path

import pytest

from tests.long import LONG
from tests.optimize.cli.conftest import small_model, small_reference, small_scene  # noqa: F401
from tests.optimize.cli.faults import ENVIRONMENT, PREPARED, SIGNALS, STREAMS, check, run
from tests.optimize.cli.test_faults import one_node  # noqa: F401

DRAWS = 300 if LONG else 4
COMMANDS = {
    "--help": (),
    "--version": (),
    "describe": ("scene.toml", "--json"),
    "explore": ("scene.toml", "--out", "OUT"),
    "explore --robust": ("scene.toml", "--shadow", "0.1", "--out", "OUT"),
    "reconstruct": ("design.json", "--scene", "scene.toml"),
    "colors": ("one.npz", "--method", "exact"),
    "render": ("scene.toml", "--out", "OUT"),
    "train": ("scene.toml", "--samples", "1", "--coarse", "--out", "OUT"),
    "score": ("layout.json", "--scene", "scene.toml", "--out", "OUT"),
    "wiring": ("design.json", "--scene", "scene.toml", "--out", "OUT"),
    "compare": ("design.json", "layout.json", "--scene", "scene.toml", "--out", "OUT.html"),
    "play": ("scene.toml", "--out", "OUT.html"),
    "sensitivity": ("design.json", "--scene", "scene.toml"),
    "new": ("pad", "--out", "OUT"),
    "schema": (),
    "verify": ("design.json", "--scene", "scene.toml", "--samples", "2", "--seeds", "2"),
    "optimize": ("scene.toml", "--samples", "2", "--final-samples", "2", "--out", "OUT"),
    "frontier": ("scene.toml", "--samples", "32", "--designs", "2", "--out", "OUT"),
    "overnight": ("scene.toml", "--samples", "1", "--coarse", "--out", "OUT"),
    "status": ("OUT",),
    "status --serve": ("OUT", "--serve", "--port", "0"),
    "runs": (".", "--out", "OUT.html"),
    "report": ("OUT",),
    "check": ("--capture", "OUT"),
    "hw ports": (),
    "hw emulate": ("--port", "OUT"),
    "hw linearity": ("OUT", "--scene", "scene.toml"),
    "hw demo": ("--no-calibrate", "--out", "OUT"),
}
PLACES = {"as it is": "result", "a device": "/dev/full", "below a device": "/dev/null/result",
          "not for us": "/proc/nothing", "a folder with files": "models"}  # fmt: skip
"""What OUT may be."""
FAULTS = ("", *STREAMS, *PREPARED, *ENVIRONMENT)
LONGEST = 40.0 if LONG else 8.0
"""Seconds until a signal comes, at most; until then a command that takes longer is stopped."""


@pytest.fixture(scope="module")
def sensor(
    small_scene: Path,  # noqa: F811
    small_model: Path,  # noqa: F811
    one_node: Path,  # noqa: F811
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """Write scene, model, table and design into one folder."""
    folder = tmp_path_factory.mktemp("sensor")
    shutil.copy(small_scene, folder / "scene.toml")
    shutil.copy(one_node, folder / "one.npz")
    shutil.copytree(small_model, folder / "models" / "small8")
    words = ("explore", "scene.toml", "--out", "found")
    check(run(words, folder), folder, (0,))
    shutil.copy(folder / "found" / "design.json", folder / "design.json")
    layout = {"colors": "rrrrggbb", "angles_deg": 90}
    (folder / "layout.json").write_text(json.dumps(layout))
    shutil.rmtree(folder / "found")
    return folder


@pytest.mark.parametrize("seed", range(DRAWS))
def test_a_random_command_under_a_random_fault_ends_as_documented(
    sensor: Path, tmp_path: Path, seed: int
) -> None:
    rng = random.Random(seed)
    command = rng.choice(list(COMMANDS))
    fault, place = rng.choice(FAULTS), rng.choice(list(PLACES))
    sent = rng.choice(list(SIGNALS))
    # Short waits as often as long ones: every part of a command's life has its share.
    after = LONGEST ** rng.uniform(-0.6, 1.0)
    folder = shutil.copytree(sensor, tmp_path / "sensor")
    words = [word.replace("OUT", PLACES[place]) for word in COMMANDS[command]]
    said = f"seed {seed}: {command} {words}, {fault or 'no fault'}, {sent.name} after {after:.1f} s"
    ended = run((*command.split()[: 2 if command.startswith("hw") else 1], *words), folder, fault,
                sent=sent, after=after)  # fmt: skip
    print(said, ended.code)
    fault_found = (1,) if command == "check" else ()
    check(ended, folder, (0, 2, *fault_found, *SIGNALS[sent]))
    for path in folder.rglob("*.json"):
        json.loads(path.read_text())
