"""``tactilux reconstruct`` says what a score is worth in degrees, and who said so."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import trimesh

from optimize.design import Rating, ScoreSettings, baseline_design, save_design
from render.choose_exposure import scene_scale
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
    found = json.loads(tactilux(*words, "--json").out)
    assert (found["level"], found["effort"]) == ("surrogate", "converged")

    drawn = preview_checker(scene, coarse=True)
    monkeypatch.setattr("optimize.scoring.surrogate_model.open_model", lambda *_, **__: drawn)
    assert json.loads(tactilux(*words, "--json").out)["level"] == "preview"
    assert ", preview: errors in degrees" in " ".join(tactilux(*words).out.split())


def save_baseline(folder: Path, name: str) -> None:
    """Write the baseline of a scene as a rated ``design.json``."""
    scene = load_scene(name)
    scale = scene_scale(scene)
    settings = ScoreSettings(scale.exposure, scale.lam)
    rating = Rating("surrogate", 50.0, (45.0, 55.0), 70.0, 12.0, 8.0, settings)
    save_design(folder / "design.json", baseline_design(scene), scene, rating)


@pytest.mark.slow
def test_the_depth_of_a_press_is_read_by_both_designs_and_shown_on_a_page(
    tactilux: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("optimize.readers.press_reading.FALSE_PEAKS", 12)
    save_baseline(tmp_path, "gelsight-mini")
    trimesh.creation.icosphere(4, 3.0).export(tmp_path / "ball.stl")
    words = ("reconstruct", "design.json", "--press", "ball.stl", "--depth", 0.4, "--json")
    done = tactilux(*words)
    assert done.code == 0, done.err
    found = json.loads(done.out)
    # The same design twice, with the same noise.
    assert found["baseline"] == found["design"]
    read = found["design"]
    assert 0.0 < read["depth_rms_um"] < 50.0
    assert read["depth_rms_um"] < read["depth_worst_um"] < 100.0
    assert 1.0 <= read["detected_um"] < 20.0
    assert read["clipped"] < 0.05
    assert read["exposure_factor"] > 0.5
    page = (tmp_path / "design-depth-ball.html").read_text()
    assert found["page"] == "design-depth-ball.html"
    assert page.count("data:image/png") == 4
    assert f"{read['depth_rms_um']:.1f}" in page


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--press", "bal"), "allowed: ball, edge, bolt or a mesh file, did you mean ball?"),
        (("--press", "none"), "allowed: ball, edge, bolt or a mesh file"),
        (("--press", "ball", "--samples", "10"), "give --samples or --press, not both"),
        (("--depth", "0.2"), "--depth is for --press"),
        (("--press", "edge", "--out", "x.png"), "allowed: .html, .htm"),
        (("--press", "ball", "--depth", "3"), "allowed: less than its radius, 3 mm"),
    ],
)
def test_what_cannot_be_pressed_is_said_before_anything_is_drawn(
    tactilux: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    more: tuple[str, ...],
    said: str,
) -> None:
    save_baseline(tmp_path, "gelsight-mini")
    monkeypatch.setattr("render.preview.Preview.__init__", lambda *_, **__: pytest.fail("drawn"))
    done = tactilux("reconstruct", "design.json", *more)
    assert done.code == 2
    assert said in " ".join(done.err.split())


def test_depth_is_not_read_on_a_curved_skin(tactilux: Run, tmp_path: Path) -> None:
    save_baseline(tmp_path, "digit-dome")
    done = tactilux("reconstruct", "design.json", "--press", "ball")
    assert done.code == 2
    assert "digit-dome has a curved skin, allowed where depth is read: a flat one" in done.err
