"""A room with lamps and objects in it, which Mitsuba's own ``path`` and ``volpath`` can render."""

from __future__ import annotations

from types import ModuleType
from typing import Any

from tests.validation.film import camera, gray


def color(mi: ModuleType, rgb: list[float]) -> dict[str, Any]:
    """Return a colored value, or its mean in mono variants."""
    if "rgb" in str(mi.variant()):
        return {"type": "rgb", "value": rgb}
    return gray(mi, sum(rgb) / 3)


def milk(mi: ModuleType, density: float = 1.5, g: float = 0.5) -> dict[str, Any]:
    """Return a homogeneous medium, colored in rgb variants; ``density`` in 1/mm."""
    return {
        "type": "homogeneous",
        "albedo": color(mi, [0.95, 0.9, 0.7]),
        "sigma_t": color(mi, [0.8, 1.0, 0.4]),
        "scale": 1.3 * density,
        "phase": {"type": "hg", "g": g},
    }


def glass(alpha: float) -> dict[str, Any]:
    """Return a dielectric of index 1.5, smooth where ``alpha`` is 0."""
    if alpha == 0:
        return {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    return {
        "type": "roughdielectric", "distribution": "beckmann", "alpha": alpha,
        "int_ior": 1.5, "ext_ior": 1.0,
    }  # fmt: skip


def ball(x: float, bsdf: dict[str, Any], medium: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return a sphere at ``x``."""
    inside = {} if medium is None else {"interior": medium}
    return {"type": "sphere", "center": [x, -0.3, 0.0], "radius": 0.65, "bsdf": bsdf, **inside}


def room(mi: ModuleType, *, point: bool, size: int = 8, **objects: dict[str, Any]) -> Any:
    """Return a loaded room of half-width 2, lit by two lamps and, on demand, by a point.

    Mitsuba's ``path`` cannot find the light of a point through smooth glass.
    """
    transform = mi.ScalarTransform4f()
    content: dict[str, Any] = {
        "type": "scene",
        "room": {
            "type": "cube", "flip_normals": True, "to_world": transform.scale(2),
            "bsdf": {"type": "diffuse", "reflectance": color(mi, [0.7, 0.5, 0.3])},
        },
        "lamp": {
            "type": "rectangle",
            "to_world": transform.translate([0, 1.95, 0]).rotate([1, 0, 0], 90).scale(1.5),
            "bsdf": {"type": "diffuse", "reflectance": gray(mi, 0.2)},
            "emitter": {"type": "area", "radiance": color(mi, [2.0, 1.5, 1.0])},
        },
        "side": {
            "type": "sphere", "center": [-1.5, 0.6, 0.6], "radius": 0.4,
            "bsdf": {"type": "diffuse", "reflectance": gray(mi, 0.0)},
            "emitter": {"type": "area", "radiance": color(mi, [0.5, 1.0, 2.0])},
        },
        "sensor": camera(mi, [0, 0, 1.9], size=size, fov=80),
        **objects,
    }  # fmt: skip
    if point:
        content["point"] = {
            "type": "point", "position": [1.3, 0.9, 1.0],
            "intensity": color(mi, [1.0, 2.0, 3.0]),
        }  # fmt: skip
    return mi.load_dict(content)
