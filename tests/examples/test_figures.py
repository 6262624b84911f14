"""docs/figures.md has every figure with its command, and says of Fig. 5.1 what is true today."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "figures.md").read_text(encoding="utf-8")
FIGURES = ("3.2", "3.3", "3.5", "3.6", "5.1", "5.2", "5.3")


def made(figure: str, out: Path, *effort: object) -> Any:
    """Make one figure by its command and return its numbers."""
    command = [sys.executable, "examples/figures.py", figure, out, *map(str, effort)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    path = out / f"fig-{figure}.png"
    assert done.stdout == f"{path}\n"
    assert path.read_bytes().startswith(b"\x89PNG")
    return json.loads(path.with_suffix(".json").read_text())


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    numbers: dict[str, Any] = made("5.1", tmp_path_factory.mktemp("figures"))
    return numbers


@pytest.mark.parametrize("figure", FIGURES)
def test_the_page_has_the_figure_its_data_and_the_command_that_made_both(figure: str) -> None:
    section = PAGE.partition(f"## Fig. {figure}")[2].partition("\n## ")[0]
    assert re.search(rf"^python examples/figures\.py {figure} docs/figures", section, re.MULTILINE)
    for word in ("**Agrees", "**Does not"):
        assert word in section
    assert f"](figures/fig-{figure}.png)" in section
    assert f"](figures/fig-{figure}.json)" in section
    size = (ROOT / "docs" / "figures" / f"fig-{figure}.png").stat().st_size
    assert size < 400_000
    json.loads((ROOT / "docs" / "figures" / f"fig-{figure}.json").read_text())


def test_the_baseline_is_good_at_the_tip_and_worse_with_every_bend(maps: dict[str, Any]) -> None:
    rows = np.array(maps["baseline"]["M"]).reshape(3, 5, 3).mean(axis=2)
    assert (np.diff(rows, axis=1) > 0).all()  # from base to tip
    assert (np.diff(rows, axis=0) < 0).all()  # from flat to bent


def test_colors_make_it_even_and_directions_add_little(maps: dict[str, Any]) -> None:
    baseline, colors, optimized = (maps[name] for name in ("baseline", "colors", "optimized"))
    assert colors["spread_sites"] < 0.75 * baseline["spread_sites"]
    assert colors["spread_bends"] < 0.9 * baseline["spread_bends"]
    gains = colors["score"] - baseline["score"], optimized["score"] - colors["score"]
    assert 0 < gains[1] < 0.25 * gains[0]


def test_an_unknown_figure_is_refused() -> None:
    command = [sys.executable, "examples/figures.py", "9.9", "out"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2
    assert "invalid choice: '9.9'" in done.stderr
