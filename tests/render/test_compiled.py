"""Compiled functions: without a folder to keep machine code in, and after their sources change."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.caching import CacheImpl

from render.compiled import compiled


def total(values: np.ndarray) -> float:
    result = 0.0
    for value in values:
        result += value
    return result


def test_an_install_without_a_writable_cache_still_computes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(CacheImpl, "_locator_classes", [])
    assert compiled(total)(np.array([1.0, 2.0])) == 3.0


def test_stored_machine_code_follows_the_other_files_of_its_folder(tmp_path: Path) -> None:
    inner = """
from typing import NamedTuple
from render.compiled import compiled
OFFSET = 1.0
class Ends(NamedTuple): low: float; high: float
@compiled
def scaled(value): return 2.0 * value
"""
    outer = """
from render.compiled import compiled
from inner import OFFSET, Ends, scaled
@compiled
def total(ends): return scaled(ends.low) + OFFSET
"""
    code = f"""
import sys
sys.path[:0] = [{str(Path(__file__).parents[2])!r}, {str(tmp_path)!r}]
from outer import Ends, total
print(total(Ends(10.0, 20.0)), sum(total.stats.cache_hits.values()))
"""

    def result_and_hits() -> str:
        command = [sys.executable, "-B", "-c", code]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    (tmp_path / "outer.py").write_text(outer)
    (tmp_path / "inner.py").write_text(inner)
    assert result_and_hits() == "21.0 0"
    assert result_and_hits() == "21.0 1"
    for old, new, expected in (
        ("2.0 * value", "3.0 * value", "31.0 0"),
        ("OFFSET = 1.0", "OFFSET = 2.0", "32.0 0"),
        ("low: float; high: float", "high: float; low: float", "62.0 0"),
    ):
        assert old in inner
        inner = inner.replace(old, new)
        (tmp_path / "inner.py").write_text(inner)
        assert result_and_hits() == expected
