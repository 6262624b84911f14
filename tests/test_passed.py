"""A long test run that was stopped goes on behind what had passed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

TESTS = """
import os
import pytest

@pytest.mark.parametrize("name", ["a", "b c", "d"])
def test_one(name):
    if name == "b c" and "STOP" in os.environ:
        os._exit(9)
    assert name != "d" or "MENDED" in os.environ
"""


def run(folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    options = ["-p", "tests.passed", "--passed", str(folder / "passed"), "-p", "no:cacheprovider"]
    options += ["-c", "/dev/null", "--rootdir", str(folder), str(folder / "test_it.py")]
    return subprocess.run(
        [sys.executable, "-m", "pytest", *options], capture_output=True, text=True, check=False,
        env={"PATH": "", "PYTHONPATH": str(Path(__file__).parents[1]), **environment},
    )  # fmt: skip


def test_what_passed_is_left_out_when_a_run_goes_on(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(TESTS)
    assert run(tmp_path, STOP="1").returncode == 9
    assert (tmp_path / "passed").read_text() == "test_it.py::test_one[a]\n"
    again = run(tmp_path)
    assert again.returncode == 1
    assert "1 failed, 1 passed, 1 deselected" in again.stdout
    mended = run(tmp_path, MENDED="1")
    assert mended.returncode == 0
    assert "1 passed, 2 deselected" in mended.stdout


def test_a_run_with_nothing_left_succeeds(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text("def test_it(): pass\n")
    assert run(tmp_path).returncode == 0
    done = run(tmp_path)
    assert (done.returncode, "1 deselected" in done.stdout) == (0, True)
