"""Nights in a world in which much goes wrong end as in one in which nothing does."""

from __future__ import annotations

import json
import os
import subprocess
import sys

from tests.long import LONG
from tests.optimize.overnight.tiny import ROOT

NIGHTS = 5000 if LONG else 100
LEAST_A_MINUTE = 1000
"""Of a processor."""


def test_nights_end_whatever_goes_wrong_and_one_integer_replays_any() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.optimize.overnight.simulated_nights", "0", str(NIGHTS)],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    print(found)
    assert found["nights"] == NIGHTS
    # Much went wrong.
    assert found["attempts"] > 1.5 * NIGHTS
    assert 60 * NIGHTS / found["seconds"] > LEAST_A_MINUTE
