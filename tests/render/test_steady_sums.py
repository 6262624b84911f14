"""Another number of cores or threads, the same bits."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from render.steady_sums import SETTINGS, steady_sums

ROOT = Path(__file__).parents[2]
MACHINES = ("taskset -c 0", "env", "env OPENBLAS_NUM_THREADS=2 OMP_NUM_THREADS=2")
"""Words before a command that change its cores or threads."""
SUMS = """
import hashlib
import numpy as np
from render.steady_sums import steady_sums
a = np.random.default_rng(1).random((700, 701))
with steady_sums():
    import scipy.linalg  # has a BLAS of its own
    found = [a @ a.T, np.linalg.lstsq(a, a[:, :3])[0], np.linalg.eigh(a @ a.T)[1]]
    found += [scipy.linalg.blas.dgemm(1.0, a, a.T), scipy.linalg.svdvals(a)]
print(hashlib.sha256(b"".join(np.ascontiguousarray(each).tobytes() for each in found)).hexdigest())
"""


def printed(machine: str, *words: object) -> str:
    """Return what Python prints on one of `MACHINES`."""
    free = {name: value for name, value in os.environ.items() if name not in SETTINGS}
    done = subprocess.run(
        [*machine.split(), sys.executable, *map(str, words)], cwd=ROOT, text=True,
        env={**free, "PYTHONPATH": str(ROOT)}, capture_output=True, check=True,
    )  # fmt: skip
    return done.stdout


def threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info()}


def test_sums_have_the_same_bits_on_any_number_of_cores() -> None:
    assert len({printed(machine, "-c", SUMS) for machine in MACHINES}) == 1


def test_threads_are_as_before_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    np.ones((2, 2)) @ np.ones((2, 2))
    with threadpool_limits(2):
        with steady_sums(), steady_sums():
            assert threads() == {1}
            assert {os.environ[name] for name in SETTINGS} == {"1"}
        assert threads() == {2}
    assert os.environ["OMP_NUM_THREADS"] == "2"
    assert "MKL_NUM_THREADS" not in os.environ


@pytest.mark.slow
def test_an_exploration_finds_the_same_design_on_any_number_of_cores(tmp_path: Path) -> None:
    found = set()
    for number, machine in enumerate((MACHINES[0], MACHINES[-1])):
        out = tmp_path / f"{number}"
        printed(machine, "-m", "hw.cli", "explore", "finger20", "--out", out)
        found.add(hashlib.sha256((out / "design.json").read_bytes()).hexdigest())
    assert len(found) == 1
