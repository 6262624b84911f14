"""Numbers of a scene file are varied by key and values; what makes no sensor is refused at once."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.dimensions import Variants, dimension, dimension_of, dimensions_of, numbers_of
from render.errors import SceneError
from render.scene import Scene, load_scene, shipped_scenes


@pytest.fixture(scope="module")
def digit() -> Scene:
    return load_scene("digit")


def refusal(scene: Scene, *texts: str, lamps_follow: bool = False) -> str:
    with pytest.raises(SceneError) as raised:
        Variants(scene, [dimension_of(scene, text) for text in texts], lamps_follow=lamps_follow)
    return str(raised.value)


def test_a_range_has_the_values_that_people_mean(digit: Scene) -> None:
    one = dimension_of(digit, "pad.thickness=3.5:4.1:0.1")
    assert one.values == (3.5, 3.6, 3.7, 3.8, 3.9, 4.0, 4.1)
    assert (one.unit, one.present) == ("mm", 6.15)
    assert dimension_of(digit, "pad.thickness = 4:5.2:0.5").values == (4.0, 4.5, 5.0)


def test_a_list_is_sorted_and_each_value_is_there_once(digit: Scene) -> None:
    assert dimension_of(digit, "pad.thickness=5,4,5").values == (4.0, 5.0)
    by_program = dimensions_of(digit, {"pad.thickness": np.array([5.0, 4.0])})
    assert by_program == [dimension_of(digit, "pad.thickness=4,5")]


@pytest.mark.parametrize("name", shipped_scenes())
def test_every_number_of_a_shipped_scene_may_be_varied_to_itself(name: str) -> None:
    scene = load_scene(name)
    for key, (present, unit) in numbers_of(scene).items():
        one = dimension(scene, key, [present])
        assert (one.present, one.unit) == (present, unit)
        assert scene.with_(**one.changes(present)).hash == scene.hash, key


def test_a_key_without_its_number_is_that_of_all_rows_or_of_one_edge() -> None:
    scene = load_scene("gelsight-mini")
    assert dimension_of(scene, "rows.height=2").places == (
        "rows.0.height",
        "rows.1.height",
        "rows.2.height",
    )
    assert dimension_of(scene, "rows.tip.height=2").places == ("rows.1.height",)
    assert "count has several values (rows.0.count = 4, " in refusal(scene, "rows.count=2")


def test_what_is_judged_by_and_what_is_no_number_is_no_dimension(digit: Scene) -> None:
    assert "did you mean pad.thickness?" in refusal(digit, "pad.thicknes=1,2")
    assert "belongs to what digit is judged by, allowed: pad.width" in refusal(
        digit, "sites.spacing=2,3"
    )
    assert "is no number" in refusal(digit, "lamps.position=1")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("pad.thickness", "allowed: KEY=LOW:HIGH:STEP or KEY=A,B,C"),
        ("=1,2", "allowed: KEY="),
        ("pad.thickness=1:2", "allowed: KEY="),
        ("pad.thickness=a,2", "pad.thickness=a, allowed: finite numbers"),
        ("pad.thickness=nan", "allowed: finite numbers"),
        ("pad.thickness=6:2:1", "allowed: LOW at most HIGH"),
        ("pad.thickness=1:2:0", "a STEP above 0"),
        ("pad.thickness=0:1000:0.001", "has 1,000,001 values, allowed: at most 64"),
        ("rows.count=1.5", "rows.count = 1.5, allowed: whole numbers"),
    ],
)
def test_rubbish_is_one_sentence_with_the_key(digit: Scene, text: str, told: str) -> None:
    assert told in refusal(digit, text)


@pytest.mark.parametrize("vary", [{}, [1], {"pad.thickness": 4}, {"pad.thickness": [4, "x"]}])
def test_a_program_is_told_what_may_be_varied(digit: Scene, vary: object) -> None:
    with pytest.raises(SceneError, match="allowed: "):
        dimensions_of(digit, vary)  # type: ignore[arg-type]


def test_all_values_that_make_no_sensor_are_refused_at_once_with_those_that_fit(
    digit: Scene,
) -> None:
    told = refusal(digit, "pad.thickness=2:6:0.5", "coating.albedo=0.8:1.4:0.2")
    assert "pad.thickness = 2, 2.5, 3 mm makes no valid sensor (rows.0 at z = 3.075 mm" in told
    assert "of these values fit 3.5 to 6" in told
    assert "coating.albedo = 1.2, 1.4 makes no valid sensor (" in told
    assert "of these values fit 0.8 to 1" in told
    assert "lamps_follow moves lamps with the thickness" in told


def test_combinations_that_make_no_sensor_are_left_out(digit: Scene) -> None:
    texts = "pad.thickness=4:6:1", "rows.height=3:5:1"
    variants = Variants(digit, [dimension_of(digit, text) for text in texts])
    assert (variants.count, len(variants)) == (9, 8)
    assert (4.0, 5.0) not in variants
    assert variants.at((5.0, 4.0)).pad.thickness == 5.0


@pytest.mark.parametrize("name", ["digit", "finger20", "gelsight-mini"])
def test_lamps_that_follow_keep_their_part_of_the_thickness(name: str) -> None:
    scene = load_scene(name)
    variants = Variants(scene, [dimension_of(scene, "pad.thickness=2:3:0.5")], lamps_follow=True)
    for (thickness,) in variants:
        other = variants.at((thickness,))
        ratio = thickness / scene.pad.thickness
        for row, before in zip(other.rows or (), scene.rows or (), strict=True):
            assert row.height == pytest.approx(ratio * before.height)
        for lamp, was in zip(other.lamps or (), scene.lamps or (), strict=True):
            assert lamp.position == pytest.approx((*was.position[:2], ratio * was.position[2]))
        if scene.fibers is not None:
            assert other.fibers is not None
            assert other.fibers.height == pytest.approx(ratio * scene.fibers.height)


def test_what_cannot_be_studied_is_refused(digit: Scene) -> None:
    assert "allowed: another value" in refusal(digit, "pad.thickness=6.15")
    assert "varied twice" in refusal(digit, "rows.height=2,3", "rows.tip.height=2,3")
    assert "which is not varied" in refusal(digit, "camera.distance=14", lamps_follow=True)
    many = [f"{key}=0.5:0.9:0.01" for key in ("coating.albedo", "rows.gap", "pad.roughness")]
    assert "make 68,921 sensors, allowed: at most 4,096" in refusal(digit, *many)


@pytest.mark.parametrize("name", ["digit", "finger20"])
def test_shots_that_a_file_does_not_name_are_one(name: str) -> None:
    scene = load_scene(name)
    one = dimension_of(scene, "camera.shots=1:3:1")
    assert (one.present, one.values) == (1, (1, 2, 3))
    variants = Variants(scene, [one])
    assert [variants.at((shots,)).palette.shots for shots in (1.0, 2.0, 3.0)] == [1, 2, 3]
    assert "camera.shots = 0 makes no valid sensor (camera.shots = 0: allowed: 1 to 4)" in refusal(
        scene, "camera.shots=0,1"
    )
