"""The demonstration runs from end to end and names every fault that it makes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import Run

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder that the demonstration keeps; what it said is beside it."""
    tmp_path = tmp_path_factory.mktemp("demonstration")
    done = subprocess.run(
        [
            *(sys.executable, "-m", "hw.cli", "hw", "demo", "--no-calibrate"),
            *("--rays", "20000", "--out", str(tmp_path / "demo"), "--json"),
            *("--keep", str(tmp_path / "kept")),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert f"tactilux hw linearity {tmp_path}/kept/additive" in done.stderr
    (tmp_path / "said.json").write_text(done.stdout)
    return tmp_path / "kept"


def test_the_demonstration_names_its_own_faults(kept: Path) -> None:
    checks = json.loads((kept.parent / "said.json").read_text())["checks"]
    found = {
        name: [
            (fiber["index"], fiber["state"]) for fiber in check["fibers"] if fiber["state"] != "ok"
        ]
        for name, check in checks.items()
    }
    assert found == {
        "healthy": [],
        "fiber 4 dead": [(4, "dead")],
        "fiber 9 at half power": [(9, "dim")],
        "fiber 12 with swapped colors": [(12, "swapped")],
    }


def test_what_the_demonstration_keeps_is_there_to_try_the_other_commands_on(
    kept: Path, tactilux: Run
) -> None:
    additive = tactilux("hw", "linearity", kept / "additive")
    assert additive.code == 0, additive.err
    assert "the camera is linear" in additive.out
    record = kept / "rig.npz"
    healthy = tactilux("check", "--capture", kept / "commission", "--commission", record)
    assert healthy.code == 0, healthy.out
    design = tactilux("check", "--design", kept / "design.json", "--capture", kept / "healthy",
                      "--rig", record)  # fmt: skip
    assert design.code == 0, design.out
    dead = tactilux("check", "--capture", kept / "fiber-4-dead", "--rig", record)
    assert dead.code == 1
    assert dead.out.startswith("Fiber 4 is dead")
