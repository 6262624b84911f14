"""The notebook runs from its first cell to its last."""

from __future__ import annotations

import json
import re
from pathlib import Path

import matplotlib as mpl
import pytest

pytestmark = pytest.mark.slow

NOTEBOOK = Path(__file__).parents[2] / "examples" / "first_design.ipynb"


def test_the_notebook_finds_a_better_design(capsys: pytest.CaptureFixture[str]) -> None:
    mpl.use("Agg")
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert len(cells) == 10
    names: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    said = capsys.readouterr().out
    degrees = {
        name: float(value)
        for name, value in re.findall(r"^(Baseline|Best S|Optimized) +([\d.]+) deg", said, re.M)
    }
    assert degrees["Optimized"] < degrees["Best S"] < degrees["Baseline"]
    assert "optimized: smallest color step" in said
    assert '"scene_hash"' in said
