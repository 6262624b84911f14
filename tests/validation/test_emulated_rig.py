"""The demonstration runs from end to end and names every fault that it makes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_demonstration_names_its_own_faults(tmp_path: Path) -> None:
    done = subprocess.run(
        [
            *(sys.executable, "-m", "hw.cli", "hw", "demo", "--no-calibrate"),
            *("--rays", "20000", "--out", str(tmp_path / "demo"), "--json"),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    checks = json.loads(done.stdout)["checks"]
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
