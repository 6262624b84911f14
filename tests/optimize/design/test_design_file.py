"""Design files: a faithful round trip, and one clear sentence for every way to be wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.design import (
    Design,
    Rating,
    ScoreSettings,
    baseline_design,
    load_design,
    load_design_file,
    load_layout,
    open_rated,
    save_design,
)
from render.errors import DesignError
from render.scene import Scene, load_scene, scene_text
from render.scene.scene_file import scene_from_text
from tests.colored_scenes import mono

RATING = Rating("surrogate", 90.0, (88.0, 92.0), 110.0, 15.0, 5.0, ScoreSettings(1e4, 60.0))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


@pytest.fixture
def path(tmp_path: Path, scene: Scene) -> Path:
    target = tmp_path / "design.json"
    save_design(target, baseline_design(scene), scene, RATING)
    return target


def edited(path: Path, edit: Callable[[dict[str, Any]], object]) -> Path:
    content = json.loads(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))
    return path


def test_a_design_survives_the_round_trip(tmp_path: Path, scene: Scene) -> None:
    rng = np.random.default_rng(0)
    design = Design(np.pi * rng.random(20), rng.random((20, 3)))
    save_design(tmp_path / "design.json", design, scene, RATING)
    saved = load_design_file(tmp_path / "design.json")
    np.testing.assert_allclose(saved.design.phi, design.phi, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(saved.design.power, design.power)
    assert saved.rating == RATING
    assert saved.scene_hash == scene.hash
    assert "numpy" in saved.versions
    assert [item.name for item in tmp_path.iterdir()] == ["design.json"]


def test_directions_at_both_limits_survive_exactly(tmp_path: Path, scene: Scene) -> None:
    design = Design.of_colors(np.tile([0.0, np.pi], 10), [0] * 20)
    save_design(tmp_path / "design.json", design, scene)
    loaded = load_design(tmp_path / "design.json", scene)
    np.testing.assert_array_equal(loaded.phi, design.phi)
    assert load_design_file(tmp_path / "design.json").rating is None


def test_the_file_names_colors_and_degrees(path: Path) -> None:
    content = json.loads(path.read_text())
    assert content["colors"][8] == "blue"
    assert content["angles_deg"][0] == 90.0
    assert content["conventions"]["ddof"] == 0
    assert content["score"]["interval"] == [88.0, 92.0]


def test_a_file_with_the_british_key_is_still_read(path: Path) -> None:
    saved = load_design_file(path)
    edited(path, lambda content: content.update(colours=content.pop("colors")))
    np.testing.assert_array_equal(load_design_file(path).design.power, saved.design.power)


def test_a_design_for_another_scene_is_refused(path: Path, scene: Scene) -> None:
    edited(path, lambda content: content.update(scene_hash="0" * 16))
    with pytest.raises(DesignError, match=f"another scene .* allowed: hash {scene.hash}"):
        load_design(path, scene)


@pytest.mark.parametrize("folder", ["beside the design", "here"])
def test_the_scene_of_a_design_is_found_by_its_name_and_only_if_its_hash_is_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    run, here = tmp_path / "run", tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    text = scene_text("finger20").replace('name = "finger20"', 'name = "mine"')
    mine = scene_from_text(text.replace("value = 18.0", "value = 17.0"), "mine", Path())
    save_design(run / "design.json", baseline_design(mine), mine, RATING)
    with pytest.raises(DesignError, match=r"there is no mine\.toml here: name its TOML file"):
        open_rated(run / "design.json")
    with pytest.raises(DesignError, match="neither a shipped scene nor a file"):
        load_layout(run / "design.json")
    file = (here if folder == "here" else run) / "mine.toml"
    file.write_text(text.replace("value = 18.0", "value = 17.0"))
    assert open_rated(run / "design.json").scene.hash == mine.hash
    assert load_layout(run / "design.json")[0].hash == mine.hash
    file.write_text(text)
    with pytest.raises(DesignError, match="made for another scene"):
        open_rated(run / "design.json")


def test_a_design_of_other_colors_is_a_layout_too(tmp_path: Path) -> None:
    scene = mono(tmp_path)
    design = baseline_design(scene)
    save_design(tmp_path / "design.json", design, scene)
    found, loaded = load_layout(tmp_path / "design.json", str(tmp_path / "scene.toml"))
    assert found.hash == scene.hash
    np.testing.assert_array_equal(loaded.drive, design.drive)


def test_a_design_with_another_number_of_fibers_is_refused(tmp_path: Path, scene: Scene) -> None:
    with pytest.raises(DesignError, match="has 3 fibers, allowed: 20"):
        save_design(tmp_path / "design.json", Design.of_colors(np.zeros(3), [0, 1, 2]), scene)
    assert not (tmp_path / "design.json").exists()


@pytest.mark.parametrize(
    ("edit", "sentence"),
    [
        (lambda c: c["angles_deg"].__setitem__(3, 190.0), r"angles_deg\[3\] = 190.*at most 180"),
        (lambda c: c["angles_deg"].__setitem__(3, -1), r"angles_deg\[3\] = -1.*at least 0"),
        (
            lambda c: c["angles_deg"].__setitem__(0, "90"),
            r'angles_deg\[0\] = "90", allowed: a number',
        ),
        (lambda c: c["angles_deg"].__setitem__(0, float("nan")), r"\[0\] = NaN, allowed: a finite"),
        (lambda c: c["power"][5].__setitem__(1, 1.2), r"power\[5\]\[1\] = 1.2.*at most 1"),
        (lambda c: c["angles_deg"].pop(), "lengths 19, 20 and 20, allowed: one entry per fiber"),
        (lambda c: c["colors"].__setitem__(2, "blue"), r"colors\[2\] = blue contradicts"),
        (lambda c: c["colors"].__setitem__(2, "pink"), r'colors\[2\] = "pink"'),
        (lambda c: c.update(notes="x"), "unknown key notes"),
        (lambda c: c["conventions"].update(notes="x"), "unknown key conventions.notes"),
        (lambda c: c["conventions"].update(ddof=7), "conventions.ddof = 7"),
        (lambda c: c.pop("power"), "missing key power"),
        (lambda c: c.update(lam=None), "must be given together"),
        (lambda c: c.update(schema=3), "schema = 3"),
        (lambda c: c.update(level="guess"), 'level = "guess", allowed: "preview"'),
    ],
)
def test_a_malformed_file_raises_one_clear_error(
    path: Path, edit: Callable[[dict[str, Any]], object], sentence: str
) -> None:
    with pytest.raises(DesignError, match=sentence) as caught:
        load_design_file(edited(path, edit))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"PK\x03\x04", b"[1, 2]", b"null"])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "design.json").write_bytes(content)
    with pytest.raises(DesignError, match="is not a valid design: "):
        load_design_file(tmp_path / "design.json")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DesignError, match=r"No such file.*give the path"):
        load_design_file(tmp_path / "nothing.json")


def test_a_rating_that_is_not_a_number_is_not_saved(tmp_path: Path, scene: Scene) -> None:
    failed = replace(RATING, score=float("nan"))
    with pytest.raises(DesignError, match=r"score\.value = NaN"):
        save_design(tmp_path / "design.json", baseline_design(scene), scene, failed)
    assert not any(tmp_path.iterdir())


def test_a_design_whose_scale_depended_on_noise_keeps_its_lights_and_loses_its_score(
    path: Path, scene: Scene
) -> None:
    edited(path, lambda content: content.update(schema=1))
    np.testing.assert_array_equal(load_design(path, scene).phi, baseline_design(scene).phi)
    assert load_design_file(path).rating is None
    with pytest.raises(DesignError, match="rate it with tactilux score"):
        open_rated(path)
