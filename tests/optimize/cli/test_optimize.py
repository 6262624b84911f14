"""``tactilux optimize`` renders, refits and takes its renders up again."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from optimize.design import load_design_file
from render.scene import scene_text

Run = Callable[..., Any]


@pytest.mark.slow
def test_the_loop_renders_and_goes_on_from_the_kept_renders(
    tactilux: Run, small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    command = ["optimize", small_scene, "--model", small_model, "--out", "run", "--rounds", 1]
    command += ["--samples", 2, "--final-samples", 2, "--final-seeds", 1]
    first = tactilux(*command, "--json")
    assert first.code == 0, first.err
    result = json.loads(first.out)
    assert list(result["finalists"]) == ["baseline", "winner", "runner-up"]
    assert [entry["number"] for entry in result["loop"]["rounds"]] == [1]
    saved = load_design_file(tmp_path / "run" / "design.json")
    assert saved.rating is not None
    assert saved.rating.level == "reference"
    assert saved.rating.score == result["finalists"]["winner"]["score"]["value"]
    assert {item.name for item in tmp_path.iterdir()} == {"run", "run-renders"}
    assert {item.name for item in (tmp_path / "run").iterdir()} == {
        "baseline.json", "design.json", "runner-up.json", "result.json", "report.html",
        "wiring.csv", "mounted.json", "jig.stl", "scene.toml", "board.dxf", "board.svg",
    }  # fmt: skip
    page = (tmp_path / "run" / "report.html").read_text()
    assert result["report"] == "run/report.html"
    for title in ("Baseline", "Verification loop", "Its runner-up", "Wiring sheet"):
        assert title in page
    assert f"{saved.rating.score:.1f} ± " in page
    assert "Round 1, " in page
    assert all(warning in unescape(page) for warning in result["warnings"])
    assert not re.search(r"<script|<link|@import|url\(|https?://", page)

    again = tactilux(*command)
    assert again.code == 0, again.err
    assert f"{saved.rating.score:.2f}" in again.out
    assert "The loop stopped because" in again.out


def test_places_of_the_file_are_what_is_searched(tactilux: Run, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(scene_text("digit") + '\n[[search.places]]\nedge = "left"\n')
    # The thesis's procedure knows no constraints, which the scene with places has.
    refused = tactilux("optimize", path, "--method", "thesis")
    assert refused.code == 2
    assert "scene digit-places has constraints" in refused.err
