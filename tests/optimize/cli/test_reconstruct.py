"""``tactilux reconstruct`` says what a score is worth in degrees, and who said so."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from optimize.design import Rating, ScoreSettings, baseline_design, save_design
from render.scene import load_scene
from surrogate.preview_model import preview_checker

Run = Callable[..., Any]


def test_its_level_is_that_of_the_model_which_answered(
    tactilux: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene("digit")
    rating = Rating("preview", 50.0, (45.0, 55.0), 70.0, 12.0, 8.0, ScoreSettings(1e5, 80.0))
    save_design(tmp_path / "design.json", baseline_design(scene), scene, rating)
    words = ("reconstruct", "design.json")
    assert json.loads(tactilux(*words, "--json").out)["level"] == "surrogate"

    drawn = preview_checker(scene, coarse=True)
    monkeypatch.setattr("optimize.scoring.surrogate_model.open_model", lambda *_, **__: drawn)
    assert json.loads(tactilux(*words, "--json").out)["level"] == "preview"
    assert "level 0, preview" in " ".join(tactilux(*words).out.split())
