"""Editors get a JSON schema that takes every scene file, and no file with a bad value."""

from __future__ import annotations

import copy
import json
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft4Validator
from pydantic import ValidationError

from render.scene import Scene, scene_text, shipped_scenes
from render.scene.json_schema import scene_schema
from tests import colored_scenes
from tests.oracles.pads import CASES, content_of_case

SCHEMA = scene_schema()
VALIDATOR = Draft4Validator(SCHEMA)
FINGER20 = tomllib.loads(scene_text("finger20"))
RICH = """
[constraints]
max_red = 7
off = false
angle_step = { value = 5.0, unit = "deg", source = "jig" }
holder_thickness = { value = 2.0, unit = "mm", source = "jig" }
fixed = [{ fiber = 2, colour = "red" }, { fiber = 3, color = "off" }]

[[constraints.forbidden]]
low = { value = 0.0, unit = "deg", source = "jig" }
high = { value = 20.0, unit = "deg", source = "jig" }
fibers = [1, 2]

[constraints.colors.amber]
max = 4
power = { value = 0.5, source = "driver" }

[tolerances]
led_power = { distribution = "normal", deviation = 0.1, unit = "relative", source = "bin" }
fiber_angle = { distribution = "uniform", deviation = 2.0, unit = "deg", source = "jig" }

[free]
reduced_scattering = { value = [0.7, 1.4], unit = "1/mm", source = "silicones" }
"""
"""Sections that no shipped scene has."""


def complaints(content: dict[str, Any]) -> list[str]:
    return [error.message for error in VALIDATOR.iter_errors(content)]


def test_it_is_a_schema_of_the_draft_that_taplo_reads() -> None:
    Draft4Validator.check_schema(SCHEMA)
    assert json.loads(json.dumps(SCHEMA)) == SCHEMA


@pytest.mark.parametrize("name", shipped_scenes())
def test_every_shipped_scene_fulfills_it(name: str) -> None:
    assert complaints(tomllib.loads(scene_text(name))) == []


@pytest.mark.parametrize("case", [*CASES, "random 0", "random 7"])
def test_every_pad_of_the_tests_fulfills_it(case: str) -> None:
    assert complaints(content_of_case(case)) == []


def test_other_colors_limits_tolerances_and_free_ranges_fulfill_it(tmp_path: Path) -> None:
    colored_scenes.scene_with(tmp_path, colored_scenes.WHITE + colored_scenes.SAID)
    written = (tmp_path / "scene.toml").read_text()
    assert complaints(tomllib.loads(written)) == []
    colored_scenes.mono(tmp_path)
    assert complaints(tomllib.loads((tmp_path / "scene.toml").read_text())) == []
    assert complaints(tomllib.loads(written + RICH)) == []


def quantities(content: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the keys that lead to each value with a source."""
    if isinstance(content, dict) and "source" in content:
        yield path
    for key, part in content.items() if isinstance(content, dict) else ():
        yield from quantities(part, (*path, key))


def changed(path: tuple[Any, ...], change: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    content: dict[str, Any] = copy.deepcopy(FINGER20)
    part = content
    for key in path:
        part = part[key]
    change(part)
    return content


def other_number(value: Any) -> Any:
    return [-1e9] if isinstance(value, list) else -1e9


@pytest.mark.parametrize(
    "change",
    [
        lambda part: part.pop("source"),
        lambda part: part.update(source=" "),
        lambda part: part.update(unit="inch"),
        lambda part: part.update(value="2"),
        lambda part: part.update(value=True),
        lambda part: part.update(value=other_number(part["value"])),
        lambda part: part.update(comment="no key of a value"),
    ],
    ids=["source", "blank", "unit", "text", "truth", "range", "key"],
)
def test_no_bad_value_fulfills_it_nor_is_read(change: Callable[[dict[str, Any]], object]) -> None:
    for path in quantities(FINGER20):
        content = changed(path, change)
        assert complaints(content), path
        with pytest.raises(ValidationError):
            Scene.model_validate(content)


@pytest.mark.parametrize(
    ("path", "change"),
    [
        ((), {"pad": {}}),
        ((), {"lens": 1}),
        ((), {"schema": 3}),
        ((), {"name": "My sensor"}),
        (("fibers",), {"left": 65}),
        (("fibers",), {"left": 2.5}),
        (("baseline",), {"base": "red"}),
        (("camera",), {"lens": "fisheye"}),
        (("camera",), {"rows": None}),
        ((), {"rows": []}),
        ((), {"lamps_file": "lamps.csv"}),
    ],
)
def test_no_bad_key_fulfills_it_nor_is_read(path: tuple[str, ...], change: dict[str, Any]) -> None:
    content = changed(path, lambda part: part.update(change))
    assert complaints(content)
    with pytest.raises(ValidationError):
        Scene.model_validate(content)


@pytest.mark.parametrize(
    "profile",
    ["gauss", {}, {"sigma_v": 3.0}, {"file": "lamp.ies"}, {"cosine_exponent": {"value": 0.5}}],
)
def test_no_profile_of_another_form_fulfills_it(profile: Any) -> None:
    content = content_of_case("base")
    content["rows"][0]["profile"] = profile
    assert complaints(content)


@pytest.mark.parametrize(
    "said",
    [{}, {"black": False}, {"black": True, "white": {"value": 0.5, "source": "paint"}},
     {"mirror": {"value": 1.5, "source": "silver"}}],
)  # fmt: skip
def test_no_face_of_no_or_several_kinds_fulfills_it(said: dict[str, Any]) -> None:
    content = content_of_case("black walls")
    assert complaints(content) == []
    content["faces"] = [{"on": ["base"], **said}]
    assert complaints(content)
    with pytest.raises(ValidationError):
        Scene.model_validate(content)


@pytest.mark.parametrize("spread", [{"deviation": 0}, {"deviation": 31}, {"distribution": "even"}])
def test_no_bad_tolerance_fulfills_it(spread: dict[str, Any]) -> None:
    good = {"distribution": "normal", "deviation": 2, "unit": "deg", "source": "jig"}
    assert complaints(FINGER20 | {"tolerances": {"fiber_angle": good}}) == []
    assert complaints(FINGER20 | {"tolerances": {"fiber_angle": good | spread}})


def test_every_key_says_its_range_or_what_it_is() -> None:
    words = SCHEMA["definitions"]["Camera"]["properties"]["field_of_view"]["description"]
    assert words == "field_of_view is the full angle over all rows. Allowed: 1 to 300 deg."
    assert "default" not in SCHEMA["definitions"]["Row"]["properties"]["tilt"]
    assert SCHEMA["definitions"]["Row"]["properties"]["turns"]["default"] is True


def test_the_command_prints_it(tactilux: Callable[..., Any]) -> None:
    assert json.loads(tactilux("schema").out) == SCHEMA
