"""SIGKILL at any instant: what goes on ends bit-equal, nothing finished is lost or done twice."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from optimize.overnight.store import RENDERS
from tests.long import LONG
from tests.optimize.overnight.tiny import ROOT, rows

KILLS = 50 if LONG else 5


def test_kills_at_random_instants_change_nothing(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.optimize.overnight.killed", str(tmp_path), str(KILLS), "7"],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["killed"] == KILLS
    # Kills came in the middle of renders, and those went on from their states.
    assert found["resumed"] >= max(1, KILLS // 10)

    unbroken = tmp_path / "unbroken"
    wanted = {path.name: path.read_bytes() for path in (unbroken / RENDERS).iterdir()}
    assert len(wanted) == 4
    logged = rows(unbroken, "SELECT key, sha256 FROM evaluations ORDER BY key")
    for name in found["broken"]:
        run = tmp_path / name
        assert {path.name: path.read_bytes() for path in (run / RENDERS).iterdir()} == wanted
        # Every render was logged once, so none was made twice.
        assert rows(run, "SELECT key, sha256 FROM evaluations ORDER BY key") == logged
        assert len(rows(run, "SELECT * FROM decisions")) == 1
        assert not list((run / "states").iterdir())
