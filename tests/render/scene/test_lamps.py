"""Rows, listed lamps, their profiles and files: what is read, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import quad

from render.errors import SceneError
from render.scene import Profile, Scene, load_scene, scene_content, scene_of
from tests.oracles.pads import CASES, listed, row, scene_of_case

TEXT = (Path(__file__).parents[3] / "render" / "scenes" / "finger20.toml").read_text()


def scene_with(**changes: Any) -> Scene:
    CASES["this test"] = changes
    try:
        return scene_of_case("this test")
    finally:
        del CASES["this test"]


def refusal(**changes: Any) -> str:
    with pytest.raises(ValidationError) as caught:
        scene_with(**changes)
    return str(caught.value)


def rewritten(folder: Path, *changes: tuple[str, str]) -> Path:
    text = TEXT
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "scene.toml"
    path.write_text(text)
    return path


def test_a_file_of_schema_1_is_told_what_needs_schema_2(tmp_path: Path) -> None:
    path = rewritten(tmp_path, ('right = "green"', 'right = "green"\nbase = "red"'))
    with pytest.raises(SceneError, match=r"baseline\.base needs schema = 2"):
        load_scene(path)


def test_lamps_are_numbered_around_the_pad_and_then_as_listed() -> None:
    lamps = scene_with(
        rows=[row("base", 2), row("right", 2), row("left", 2), row("tip", 2)],
        lamps=[listed(0, 0, -5, 0, 0, 1)],
    ).placed_lamps()
    assert [lamp.edge for lamp in lamps][::2] == ["left", "tip", "right", "base", None]
    around = np.array([lamp.position[:2] for lamp in lamps[:8]])
    angle = np.unwrap(np.arctan2(around[:, 0], around[:, 1]))
    assert (np.diff(angle) > 0).all()  # clockwise, seen with the tip up
    assert [lamp.face for lamp in lamps[::2]] == [0, 1, 2, 3, 4]


def test_lamps_of_a_row_may_have_places_of_their_own() -> None:
    places = ([-6.0, 1.0, 7.5], "mm")
    lamps = scene_with(rows=[row("right", 3) | {"count": None, "at": places}]).placed_lamps()
    assert [lamp.position[1] for lamp in lamps] == [7.5, 1.0, -6.0]


def test_a_lamp_that_touches_a_face_keeps_a_film_of_air() -> None:
    for case in ("row touching", "below touching"):
        scene = scene_of_case(case)
        for lamp in scene.placed_lamps():
            assert scene.box.distance(lamp.position)[lamp.face] == pytest.approx(0.01)


def test_a_scene_of_lamps_comes_back_from_its_text() -> None:
    for case in ("rows of their own", "below"):
        scene = scene_of_case(case)
        assert scene_of(scene_content(scene)) == scene


@pytest.mark.parametrize(
    ("lamp", "sentence"),
    [
        (listed(0, 0, 6, 0, 0, -1), "at z = 6 mm lies above the pad, allowed: at most"),
        (listed(-10.3, 0, 2, 0, 1, 0), "cuts 0.45 mm into the silicone, allowed: at least 0.75"),
        (listed(0, 0, -5, 0, 0, 0), "direction = 0, 0, 0 points nowhere"),
        (listed(0, 0, -5, 0, 0, 1) | {"turns": True}, "shines along z and cannot turn about it"),
        (listed(0, 0, -5, 0, 0, 1) | {"position": ([1.0, 2.0], "mm")}, "position has 2 numbers"),
    ],
)
def test_where_no_lamp_can_be_is_one_sentence(lamp: dict[str, Any], sentence: str) -> None:
    assert sentence in refusal(lamps=[lamp])


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"gap": 0.3}, "cuts 0.2 mm into the silicone when it turns, allowed: more than 0.5 mm"),
        ({"gap": 0.5}, "touches the silicone when it turns, allowed: more than 0.5 mm"),
        ({"count": None}, "rows.0: needs either count or at"),
        ({"count": 30, "diameter": 1.0}, "lamps need 30 mm, allowed: at most the edge of 24 mm"),
        ({"count": None, "at": ([13.0], "mm")}, "rows.0.at = 13 mm lies beside the edge"),
        ({"profile": "gauss"}, 'must be "lambertian"'),
        ({"profile": {"file": "none.ies", "source": "x"}}, "none.ies cannot be used"),
        ({"profile": {"cosine_exponent": (0.5,)}}, "allowed: 1 to 1000"),
    ],
)
def test_rows_that_cannot_be_are_refused(changes: dict[str, Any], sentence: str) -> None:
    assert sentence in refusal(rows=[row("left", **({"count": 2} | changes))])


def test_a_row_is_refused_once_for_all_its_lamps() -> None:
    assert refusal(rows=[row("left", 3, gap=0.3)]).count("into the silicone") == 1


def test_fibers_and_rows_are_not_named_together(tmp_path: Path) -> None:
    path = rewritten(tmp_path, ("schema = 1", "schema = 2\nrows = []"))
    with pytest.raises(SceneError, match="fibers are three rows already"):
        load_scene(path)


@pytest.mark.parametrize(
    "profile",
    [
        Profile.model_construct(sigma_v=0.2),
        Profile.model_construct(cosine_exponent=1.0),
        Profile.model_construct(cosine_exponent=7.5),
        Profile.model_construct(angles=(0.0, np.pi / 2), intensity=(1.0, 0.0)),
    ],
)
def test_a_profile_has_unit_power_but_for_the_scale_of_a_table(profile: Profile) -> None:
    power, _ = quad(
        lambda t: float(profile.shape(np.array(t))) * 2 * np.pi * np.sin(t), 0, np.pi / 2
    )
    expected = 1.0
    if profile.angles is not None:
        # Intensity falls linearly to the right angle: 2 pi (1 - 2 / pi).
        expected = 2 * np.pi * (1 - 2 / np.pi)
    assert power * profile.peak_intensity == pytest.approx(expected, rel=1e-6)
