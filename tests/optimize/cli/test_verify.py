"""``tactilux verify`` renders, compares, keeps its renders and takes them up again."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from optimize.cli.verify import _print
from optimize.design import (
    PARTS,
    Design,
    RatedDesign,
    Rating,
    ScoreSettings,
    baseline_design,
    save_design,
)
from optimize.readers import RenderedDegrees
from optimize.scoring import JackknifeEstimate, RenderedScore, model_of_design
from optimize.verification import Verification
from render.scene import load_scene
from surrogate.runtime import Checker
from tests.optimize.conftest import read_by

Run = Callable[..., Any]
RATING = Rating("preview", 50.0, (45.0, 55.0), 70.0, 12.0, 8.0, ScoreSettings(1.0, 1.0))


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
    command += ["--samples", 4, "--seeds", 2, "--out", "proof/renders", "--json"]

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
    assert {item.name for item in tmp_path.iterdir()} == {"design.json", "proof"}
    assert "Renders and result: proof/renders" in said


def said(level: str, clipped: float, folder: Path) -> str:
    """Return what is printed of a design that saturates so many of its facets."""
    parts = {part: JackknifeEstimate(50.0, 50.0, np.array([49.0, 51.0])) for part in PARTS}
    rendered = RenderedScore(parts, clipped, ScoreSettings(1.0, 0.0))
    errors = [JackknifeEstimate(x, x, np.array([x, x])) for x in (1.7, 1.9, 0.2)]
    degrees = RenderedDegrees((errors[0], errors[1]), {(0, 1): errors[2]})
    both = {"sensor": degrees, "place": degrees}
    found = Verification(rendered, rendered, parts["score"], 47.99, 1.0, (1, 2), 4, both)
    checker = SimpleNamespace(level=level, score_half_width=0.81, coverage=0.9)
    out = io.StringIO()
    _print(
        out,
        folder / "design.json",
        load_scene("digit"),
        checker,
        found,
        [read_by(1.67, (1, 1)), read_by(1.93, (1, 1))],
    )  # type: ignore[arg-type]
    return out.getvalue()


@pytest.mark.parametrize("level", ["preview", "surrogate"])
def test_it_names_what_predicted_the_score(level: str, tmp_path: Path) -> None:
    text = said(level, 0.0, tmp_path)
    assert f"The {level} said 47.99, off by -2.01" in text
    # The better score may read worse: both are said.
    assert f"By the {level} the baseline reads better (1.67° for 1.93°)." in text
    worse = "The sensor reader reads the design worse than the baseline by more than the error bars"
    assert f"{worse} (+0.20°, +0.20° to +0.20°)." in text


def test_it_says_that_a_design_saturates_the_camera(tmp_path: Path) -> None:
    assert "Note" not in said("preview", 0.0, tmp_path)
    assert "Note: 75.0% of the facets saturate the camera" in said("preview", 0.75, tmp_path)


def test_a_design_rated_on_the_preview_as_drawn_waits_for_no_other(
    small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    scene = load_scene(small_scene)
    candidate = RatedDesign(scene, baseline_design(scene), RATING)
    assert model_of_design(candidate).level == "preview"


def test_renders_and_result_go_where_out_says(
    tactilux: Run, small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    scene = load_scene(small_scene)
    save_design(tmp_path / "design.json", baseline_design(scene), scene, RATING)
    command = ["verify", "design.json", "--scene", small_scene, "--model", small_model]
    refused = tactilux(*command, "--out", "file")
    assert (refused.code, refused.out) == (2, "")
    assert refused.err == "tactilux: file is not a directory: choose another place with --out\n"
