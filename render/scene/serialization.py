"""A scene as text that travels: exactly the numbers in memory, so that its hash stays the same.

A TOML file holds degrees, and degrees do not always come back to the same radians.
"""

from __future__ import annotations

import contextlib
import json
from functools import lru_cache
from typing import Any, get_args

from render.errors import SceneError
from render.files import parse_json
from render.scene.quantities import Part
from render.scene.schema import Scene

_LEFT_OUT = {"constraints", "search", "tolerances", "free"}
"""They change no light."""


def scene_content(scene: Scene) -> str:
    """Return everything that a render depends on, and the name, as JSON."""
    content = scene.model_dump(mode="json", exclude=_LEFT_OUT, exclude_none=True)
    return json.dumps({"hash": scene.hash, "scene": content}, sort_keys=True)


@lru_cache(maxsize=16)
def scene_of(text: str) -> Scene:
    """Return the scene that ``scene_content`` wrote, without what changes no light.

    Raises:
        SceneError: the text is none, or was changed on the way.
    """
    try:
        content = parse_json(text)
        scene: Scene = _part(Scene, content["scene"])
        if scene.hash == content["hash"]:
            return scene
    except (ValueError, KeyError, TypeError, AttributeError):
        pass
    raise SceneError(
        "the content of the scene does not match its hash: send it again, from the same version "
        "of tactilux",
        field="scene",
    )


def _part(kind: type[Part], content: dict[str, Any]) -> Any:
    """Return a part from values in memory units; validation would take them for file units."""
    values: dict[str, Any] = {}
    for name, field in kind.model_fields.items():
        if name not in content:
            continue
        value = content[name]
        if isinstance(value, dict):
            value = _part(part_class(field.annotation), value)
        elif isinstance(value, list):
            value = tuple(
                _part(part_class(field.annotation), item) if isinstance(item, dict) else item
                for item in value
            )
        values[name] = value
    return kind.model_construct(**values)


def part_class(annotation: Any) -> type[Part]:
    """Return the part's class, inside unions with None and tuples of parts."""
    if isinstance(annotation, type) and issubclass(annotation, Part):
        return annotation
    for kind in get_args(annotation):
        with contextlib.suppress(TypeError):
            return part_class(kind)
    raise TypeError(annotation)
