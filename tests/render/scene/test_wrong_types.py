"""A value of the wrong type, at any key of a scene file, is told in the words of the house."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from render.errors import SceneError
from render.scene.json_schema import scene_schema
from render.scene.scene_file import scene_from_text
from tests.wrong_values import FOREIGN, WRONG, Place, changed, places

SCHEMA = scene_schema()


def filled(part: dict[str, Any]) -> Any:
    """Return what holds every key that a part of the JSON schema knows, each of its type."""
    if "$ref" in part:
        return filled(SCHEMA["definitions"][part["$ref"].rpartition("/")[2]])
    for several in ("allOf", "anyOf"):
        if several in part and "properties" not in part:
            return filled(part[several][0])
    if "enum" in part:
        return part["enum"][0]
    samples = {"string": "x", "boolean": True, "integer": 1, "number": 0.5}
    if part["type"] == "array":
        return [filled(part["items"])]
    if part["type"] != "object":
        return samples[part["type"]]
    if "properties" not in part:
        (inner,) = part["patternProperties"].values()
        return {"amber": filled(inner)}
    return {key: filled(inner) for key, inner in part["properties"].items() if key != "lamps_file"}


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items()) + "}"
    return f"[{', '.join(map(toml, value))}]" if isinstance(value, list) else json.dumps(value)


def refusal(content: dict[str, Any]) -> str:
    text = "\n".join(f"{key} = {toml(value)}" for key, value in content.items())
    with pytest.raises(SceneError) as caught:
        scene_from_text(text, "a.toml", Path())
    return str(caught.value).removeprefix("a.toml is not a valid scene: ")


FILLED: dict[str, Any] = filled(SCHEMA)


def test_the_file_under_test_has_every_key_of_the_schema() -> None:
    keys = {".".join(key for key in place if isinstance(key, str)) for place in places(FILLED)}
    assert {"states.mesh.file", "rows.at.value", "camera.channels", "colors.ink"} <= keys
    assert {"tolerances.sigma_v", "free.diffuser_thickness", "skin.mesh.file"} <= keys
    assert len(keys) > 300


@pytest.mark.parametrize("key", FILLED)
def test_no_wrong_type_is_told_in_words_of_the_library(key: str) -> None:
    for place in places({key: FILLED[key]}):
        for value in WRONG:
            told = refusal(changed(FILLED, place, value))
            assert not [words for words in FOREIGN if words in told], (place, value, told)


@pytest.mark.parametrize(
    ("place", "value", "told"),
    [
        (("pad", "thickness", "value"), "four", 'pad.thickness = "four", allowed: a number'),
        (("pad", "thickness", "value"), True, "pad.thickness = true, allowed: a number"),
        (("bending", "angles", "value"), [0.0, "x"],
         'bending.angles.1 = "x", allowed: a number'),
        (("bending", "angles", "value"), 3, "bending.angles = 3, allowed: a list"),
        (("camera", "rows"), 2.5, "camera.rows = 2.5, allowed: a whole number"),
        (("rows", 0, "turns"), "yes", 'rows.0.turns = "yes", allowed: true or false'),
        (("rows", 0, "edge"), 3, 'rows.0.edge = 3, allowed: "left", "tip", "right" or "base"'),
        (("rows",), "left", 'rows = "left", allowed: a list'),
        (("name",), 20, "name = 20, allowed: a text in quotes"),
        (("window",), [1.5], "window = [1.5], allowed: a table with thickness, index"),
        (("constraints", "colors"), 1, "constraints.colors = 1, allowed: a table"),
        (("coating", "albedo", "value"), "dark",
         'coating.albedo = "dark", allowed: a number, or a list of one per camera channel'),
        (("lamps", 0, "profile"), {"x": 1}, "lamps.0.profile = { x = 1 }: must be"),
        (("schema",), "two", 'schema = "two", allowed: 1 or 2'),
    ],
)  # fmt: skip
def test_it_names_the_key_the_value_as_written_and_what_is_right(
    place: Place, value: Any, told: str
) -> None:
    assert told in refusal(changed(FILLED, place, value))
