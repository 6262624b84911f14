"""Black boxes: without light, and behind walls without an exit, everything is exactly 0."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from render.errors import RenderError
from render.scene import load_scene

SMALL = {"chains": 1024, "luminance_samples": 8192, "chains_only": True}


def closed_box(mono: ModuleType, wall: dict[str, Any], intensity: float = 5.0) -> Any:
    """Return a box around the camera, with a point light outside of it."""
    transform = mono.ScalarTransform4f()
    return mono.load_dict(
        {
            "type": "scene",
            "box": {"type": "cube", "bsdf": wall},
            "floor": {"type": "rectangle", "to_world": transform.translate([0, 0, -3]).scale(9)},
            "lamp": {"type": "point", "position": [1.5, 2.0, 2.5], "intensity": intensity},
            "sensor": {
                "type": "perspective",
                "fov": 90,
                "to_world": transform.look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, 1, 0]),
                "film": {
                    "type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"},
                },
            },
        }
    )  # fmt: skip


def render(mono: ModuleType, scene: Any, kind: str, **parameters: int) -> np.ndarray:
    parameters = SMALL | parameters if kind == "pssmlt" else parameters
    return np.array(mono.load_dict({"type": kind, **parameters}).render(scene, spp=256))


WALLS: list[dict[str, Any]] = [
    {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}},
    {"type": "twosided", "bsdf": {"type": "diffuse"}},
]


@pytest.mark.parametrize("wall", WALLS, ids=["black", "white"])
def test_inside_a_closed_box_the_camera_sees_exactly_nothing(
    mono: ModuleType, wall: dict[str, Any]
) -> None:
    assert (render(mono, closed_box(mono, wall), "bdpt", max_depth=64) == 0).all()


@pytest.mark.parametrize("wall", WALLS, ids=["black", "white"])
def test_a_picture_that_no_light_may_reach_at_any_depth_is_refused(
    mono: ModuleType, wall: dict[str, Any]
) -> None:
    with pytest.raises(RenderError, match="no light arrives at the camera"):
        render(mono, closed_box(mono, wall), "bdpt")


def test_metropolis_says_that_it_found_no_light_in_a_closed_box(mono: ModuleType) -> None:
    with pytest.raises(RenderError, match="luminance_samples"):
        render(mono, closed_box(mono, WALLS[1]), "pssmlt")


@pytest.mark.parametrize("kind", ["bdpt", "pssmlt"])
def test_a_light_of_intensity_zero_is_named(mono: ModuleType, kind: str) -> None:
    scene = closed_box(mono, {"type": "dielectric"}, intensity=0.0)
    with pytest.raises(RenderError, match=r"'lamp'.* emits nothing"):
        render(mono, scene, kind)


def test_a_pad_whose_fibers_are_all_off_is_not_rendered() -> None:
    from render.reference import render_image

    scene = load_scene("finger20")
    count = scene.lamp_count
    with pytest.raises(RenderError, match="power"):
        render_image(scene, np.full(count, 1.5), np.zeros((count, 3)), 0.0, width=8, height=8)
