"""Long work makes progress whatever interrupts it: killed every ten seconds, it ends bit-equal."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.long import LONG
from tests.optimize.overnight.commands import NAMES, left_by
from tests.optimize.overnight.tiny import ROOT

MEAN_LIFE = 10.0
MOST = 3.0
"""What a command that is killed so often may take, in units of an unbroken one."""


@pytest.mark.skipif(not LONG, reason="kills whole commands for minutes: TACTILUX_LONG=1")
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", NAMES)
def test_what_is_killed_every_ten_seconds_ends_bit_equal_in_three_times_its_time(
    tmp_path: Path, name: str, seed: int
) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.optimize.overnight.killed_commands", name, str(tmp_path),
         str(seed), str(MEAN_LIFE)],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    print(done.stdout)
    assert found["done"]
    assert len(found["lives"]) > 1
    assert left_by(name, tmp_path / "broken") == left_by(name, tmp_path / "unbroken")
    assert found["broken"] < MOST * found["unbroken"]
