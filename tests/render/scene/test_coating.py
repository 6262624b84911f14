"""The skin's albedo: one number, or one per channel of the camera."""

from __future__ import annotations

from typing import Any

import pytest
from jsonschema import Draft4Validator
from pydantic import ValidationError

from render.describe import describe
from render.errors import SceneError
from render.scene import Scene, scene_content, scene_of
from render.scene.json_schema import scene_schema
from tests.colored_skins import ALBEDOS, content_with, skin_of


def problems(albedo: Any, **content: Any) -> str:
    with pytest.raises(ValidationError) as caught:
        Scene.model_validate(content_with(albedo) | content)
    return str(caught.value)


def test_each_channel_has_its_albedo() -> None:
    scene = skin_of((0.7, 0.3, 0.7))
    assert scene.by_channel
    assert scene.albedos == (0.7, 0.3)
    assert scene.albedo_of_channel == (0, 1, 0)
    assert [one.coating.albedo for one in scene.one_albedo_scenes] == [0.7, 0.3]


def test_a_scene_of_one_albedo_has_the_hash_of_the_file_that_says_so() -> None:
    for number, one in enumerate(skin_of().one_albedo_scenes):
        assert one.hash == skin_of(ALBEDOS[number]).hash


def test_equal_numbers_are_one_number() -> None:
    alike, plain = skin_of((0.4, 0.4, 0.4)), skin_of(0.4)
    assert not alike.by_channel
    assert alike.coating.albedo == 0.4
    assert alike.hash == plain.hash
    assert scene_content(alike) == scene_content(plain)


def test_other_albedos_or_another_order_have_another_hash() -> None:
    hashes = {skin_of(each).hash for each in (0.7, (0.7, 0.3, 0.5), (0.3, 0.7, 0.5))}
    assert len(hashes) == 3


def test_such_a_scene_travels_as_text() -> None:
    scene = skin_of()
    again = scene_of(scene_content(scene))
    assert again.coating.albedo == ALBEDOS
    assert again.hash == scene.hash


@pytest.mark.parametrize(
    ("albedo", "said"),
    [
        ([0.5, 0.4], "coating.albedo has 2 values, allowed: one number, or 3, one per channel "
                     "(red, green, blue)"),
        ([], "coating.albedo has 0 values, allowed: one number, or 3"),
        ([0.5, 0.0, 0.4], "coating.albedo = 0 in channel green, allowed in a list: above 0"),
        ([0.5, 1.4, 0.4], "allowed: 0 to 1"),
        ([0.5, "red", 0.4], "Input should be a valid number"),
        (1.4, "allowed: 0 to 1"),
        (True, "allowed: a number, or a list of them"),
        ([True, 0.2, 0.3], "Input should be a valid number"),
    ],
)  # fmt: skip
def test_wrong_albedos_say_what_would_be_right(albedo: Any, said: str) -> None:
    assert said in problems(albedo)


def test_the_number_that_is_out_of_range_is_named() -> None:
    with pytest.raises(ValidationError) as caught:
        Scene.model_validate(content_with([0.5, 1.4, 0.4]))
    (problem,) = caught.value.errors()
    assert problem["loc"] == ("coating", "albedo", 1)
    assert problem["input"] == 1.4


def test_channels_are_those_of_the_camera() -> None:
    camera = content_with(0.5)["camera"] | {"channels": ["gray", "infrared"]}
    said = problems([0.5, 0.4, 0.3], camera=camera)
    assert "allowed: one number, or 2, one per channel (gray, infrared)" in said


def test_schema_1_has_one_albedo() -> None:
    assert "coating.albedo with a list of values needs schema = 2" in problems(
        [0.5, 0.4, 0.3], schema=1
    )
    assert Scene.model_validate(content_with(0.5) | {"schema": 1}).albedos == (0.5,)


def test_editors_take_lists_in_schema_2_alone() -> None:
    validator = Draft4Validator(scene_schema())
    assert validator.is_valid(content_with([0.5, 0.4, 0.3]))
    assert validator.is_valid(content_with(0.5) | {"schema": 1})
    assert not validator.is_valid(content_with([0.5, 0.4, 0.3]) | {"schema": 1})
    assert not validator.is_valid(content_with([0.5, 1.4, 0.3]))
    assert not validator.is_valid(content_with([]))


def test_who_follows_one_albedo_at_a_time_refuses_several() -> None:
    assert skin_of(0.4).coating.single_albedo == 0.4
    with pytest.raises(SceneError, match=r"coating.albedo = 0.7, 0.3, 0.5 differs by channel"):
        _ = skin_of().coating.single_albedo


def test_it_is_described_with_the_color_axis_of_the_transport() -> None:
    told, plain = describe(skin_of()), describe(skin_of(0.5))
    assert told.axes["channel"] == 3
    assert told.cells == 3 * plain.cells
    assert (
        "color axis of the transport: coating.albedo is 0.7 in red, 0.3 in green, 0.5 in blue"
        in (told.text())
    )
    left_out = "color axis of the transport"
    assert left_out not in {part.what for part in told.left_out}
    assert left_out in {part.what for part in plain.left_out}
    assert "channel" not in plain.axes
