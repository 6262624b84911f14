"""Every kind of emitter over a floor and a wall, with glass and fog for its light to pass."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from tests.validation.film import camera
from tests.validation.rooms import color


def open_room(mi: ModuleType, *, size: int = 8, **objects: Any) -> Any:
    """Return a loaded floor and a wall behind it, open to light from all other sides.

    Unoptimized: the boxes of merged meshes are invalid, with which Mitsuba's own integrators cut
    the shadow rays of light from afar (``constant`` gives up to 9 % too much by them).
    """
    transform = mi.ScalarTransform4f()
    content = {
        "type": "scene",
        "floor": {
            "type": "rectangle",
            "to_world": transform.translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(3),
            "bsdf": {"type": "diffuse", "reflectance": color(mi, [0.7, 0.5, 0.3])},
        },
        "wall": {
            "type": "rectangle", "to_world": transform.translate([0, 0, -2]).scale(3),
            "bsdf": {"type": "diffuse", "reflectance": color(mi, [0.3, 0.5, 0.7])},
        },
        "sensor": camera(mi, [0, 0.5, 4], fov=45, target=(0, -0.3, 0), size=size),
    }  # fmt: skip
    return mi.load_dict(content | objects, optimize=False)


def above(mi: ModuleType, kind: str, radius: float, emitter: dict[str, Any]) -> dict[str, Any]:
    """Return a disk or rectangle that shines down from y = 2.5."""
    to_world = mi.ScalarTransform4f().translate([0, 2.5, 0]).rotate([1, 0, 0], 90).scale(radius)
    return {"type": kind, "to_world": to_world, "emitter": emitter}


def lamp(mi: ModuleType, kind: str, folder: Path) -> dict[str, Any]:
    """Return one emitter of a kind, with its colors in rgb variants."""
    rng = np.random.default_rng(1)
    if kind == "spot":
        transform = mi.ScalarTransform4f()
        return {
            "type": "spot", "cutoff_angle": 30.0, "beam_width": 12.0,
            "to_world": transform.look_at(origin=[1, 2, 2], target=[0, -0.5, 0], up=[0, 1, 0]),
            "intensity": color(mi, [5.0, 4.0, 3.0]),
        }  # fmt: skip
    if kind == "directional":
        return {
            "type": "directional", "direction": [0.3, -1, -0.5],
            "irradiance": color(mi, [1.0, 2.0, 3.0]),
        }  # fmt: skip
    if kind == "constant":
        return {"type": "constant", "radiance": color(mi, [1.0, 0.8, 0.5])}
    if kind == "envmap":
        sky = (3 * rng.random((8, 16, 3)) ** 4 + 0.1).astype(np.float32)
        return {"type": "envmap", "bitmap": mi.Bitmap(sky)}
    if kind == "textured area":
        pattern = (9 * rng.random((4, 4, 3))).astype(np.float32)
        texture = {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(pattern)}
        return above(mi, "rectangle", 0.4, {"type": "area", "radiance": texture})
    path = folder / "led.csv"
    path.write_text("angle,intensity\n0,1\n10,2\n30,1.5\n60,0.3\n80,0\n")
    emitter = {"type": "measured_light", "filename": str(path), "power": 20.0}
    return above(mi, "disk", 0.4, emitter)


KINDS = ("spot", "directional", "constant", "envmap", "textured area", "measured_light")
