"""The notebooks run from their first cells to their last."""

from __future__ import annotations

import json
import re
from pathlib import Path

import matplotlib as mpl
import pytest

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[2] / "examples"


def said_by(notebook: str, capsys: pytest.CaptureFixture[str]) -> tuple[str, dict[str, object]]:
    """Run all cells of a notebook; return what they print, and their names."""
    mpl.use("Agg")
    names: dict[str, object] = {}
    for cell in json.loads((EXAMPLES / notebook).read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    return capsys.readouterr().out, names


def test_the_first_design_is_better(capsys: pytest.CaptureFixture[str]) -> None:
    said, _ = said_by("first_design.ipynb", capsys)
    degrees = {
        name: float(value)
        for name, value in re.findall(r"^(Baseline|Best S|Optimized) +([\d.]+) deg", said, re.M)
    }
    assert degrees["Optimized"] < degrees["Best S"] < degrees["Baseline"]
    assert "optimized: smallest color step" in said
    assert '"scene_hash"' in said


def test_a_design_study_ends_in_a_sensor_that_reads_what_was_found(
    capsys: pytest.CaptureFixture[str],
) -> None:
    said, names = said_by("design_study.ipynb", capsys)
    before, after = (float(value) for value in re.findall(r"^three .* ([\d.]+) deg,", said, re.M))
    assert after < 0.8 * before
    assert float(said.splitlines()[-1].removesuffix(" deg")) == pytest.approx(after, rel=0.02)
    assert 'name = "mine"' in names["path"].read_text()  # type: ignore[attr-defined]
