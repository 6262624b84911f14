"""Sensors whose skin has an albedo per channel, for tests, and what their light must be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from render.scene import Scene, scene_text
from tests.oracles.pads import content_of_case

ALBEDOS = (0.7, 0.3, 0.5)


def content_with(albedo: Any, case: str = "smooth", **parts: dict[str, Any]) -> dict[str, Any]:
    """Return the file of a pad of the tests whose skin has that albedo; ``parts`` replace keys."""
    content = content_of_case(case) | {"schema": 2}
    content["coating"] = {"albedo": {"value": albedo, "source": "test"}}
    for part, keys in parts.items():
        content[part] = content[part] | keys
    return content


def skin_of(albedo: Any = ALBEDOS, case: str = "smooth", **parts: dict[str, Any]) -> Scene:
    """Return the sensor of `content_with`."""
    value = list(albedo) if isinstance(albedo, tuple) else albedo
    return Scene.model_validate(content_with(value, case, **parts))


def still(case: str = "smooth", albedo: Any = ALBEDOS) -> Scene:
    """Return a sensor of two lamps that cannot turn, with few sites and facets."""
    lambertian = {"count": 1, "turns": False, "profile": "lambertian", "tilt": of(20.0, "deg")}
    row = {"diameter": of(1.0, "mm"), "gap": of(0.5, "mm"), "height": of(2.0, "mm")} | lambertian
    content = content_with(list(albedo) if isinstance(albedo, tuple) else albedo, case)
    del content["fibers"]
    content["rows"] = [{"edge": edge} | row for edge in ("left", "right")]
    content["baseline"] = {"left": "red", "right": "green"}
    return Scene.model_validate(content)


def of(value: float, unit: str) -> dict[str, Any]:
    """Return a value as a file has it."""
    return {"value": value, "unit": unit, "source": "test"}


def tinted_digit(folder: Path, albedos: tuple[float, float, float] = (0.6, 0.25, 0.45)) -> Path:
    """Return the file, written to ``folder``, of `digit` with an albedo per channel."""
    path = folder / "tinted.toml"
    plain = "albedo = { value = 0.45"
    assert plain in scene_text("digit")
    path.write_text(scene_text("digit").replace(plain, f"albedo = {{ value = {list(albedos)}"))
    return path


def stacked(parts: list[np.ndarray]) -> np.ndarray:
    """Return what scenes of one albedo gave, channel by channel."""
    return np.stack(parts, axis=-1)
