"""``tactilux verify`` renders, compares, keeps its renders and takes them up again."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from optimize.design import Design, Rating, ScoreSettings, baseline_design, save_design
from render.scene import load_scene
from surrogate.runtime import Checker

Run = Callable[..., Any]


@pytest.mark.slow
def test_it_renders_once_and_then_answers_from_its_checkpoint(
    tactilux: Run, small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    scene, checker = load_scene(small_scene), Checker.load(small_model)
    base = baseline_design(scene)
    recolored = Design.of_colors(base.phi, (base.colors + [0, 0, 1, 0, 0, 0, 0, 2]) % 3)
    rating = Rating(
        "surrogate",
        50.0,
        (45.0, 55.0),
        70.0,
        12.0,
        8.0,
        ScoreSettings(checker.exposure, checker.lam),
    )
    save_design(tmp_path / "design.json", recolored, scene, rating)
    command = ["verify", "design.json", "--scene", small_scene, "--model", small_model]
    command += ["--samples", 4, "--seeds", 2, "--json"]

    first = tactilux(*command)
    assert first.code == 0, first.err
    result = json.loads(first.out)
    assert list(result) == [
        "baseline",
        "design",
        "difference",
        "surrogate",
        "converged",
        "render_seconds",
        "seeds",
    ]
    assert result["baseline"]["se"] > 0
    low, high = result["difference"]["interval"]
    assert low < result["difference"]["value"] < high
    assert result["difference"]["value"] == pytest.approx(
        result["design"]["score"] - result["baseline"]["score"]
    )
    assert result["surrogate"]["error"] == pytest.approx(
        result["surrogate"]["score"] - result["design"]["score"]
    )
    assert result["seeds"] == [1, 2]

    said = tactilux(*command[:-1]).out
    assert result["converged"] == ("have not converged" not in said)
    if not result["converged"]:
        assert "cannot be tested" in said

    again = tactilux(*command)
    assert again.out == first.out  # render_seconds too: nothing was rendered again
    assert {item.name for item in tmp_path.iterdir()} == {"design.json", "design-renders"}
