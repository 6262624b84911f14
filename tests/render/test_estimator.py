"""The estimator's page and the integrators find the same light, by code that they do not share."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.validation.film import camera, check_same, gray, ours, theirs

EDGES, RUNS = 6, 12


def box_with(mi: ModuleType, ball: dict[str, Any]) -> Any:
    """Return the Cornell box with a ball in it, in front of its two cubes."""
    sensor = camera(mi, [0, 0, 3.9], fov=30, size=6)
    shape = {"type": "sphere", "center": [0.2, -0.5, 0.4], "radius": 0.35, **ball}
    return mi.load_dict(mi.cornell_box() | {"sensor": sensor, "ball": shape})


def fog_in_rough_glass(mi: ModuleType) -> Any:
    medium = {
        "type": "homogeneous", "albedo": gray(mi, 0.9), "sigma_t": 3.0,
        "phase": {"type": "hg", "g": 0.4},
    }  # fmt: skip
    glass = {"type": "roughdielectric", "alpha": 0.2, "int_ior": 1.4}
    return box_with(mi, {"bsdf": glass, "interior": medium})


def smooth_glass(mi: ModuleType) -> Any:
    return box_with(mi, {"bsdf": {"type": "dielectric", "int_ior": 1.5}})


def page(scene: Any, samples: int) -> np.ndarray:
    """Return independent images ``(run, row, column, channel)`` by the page."""
    from render.estimator import bidirectional_image

    return np.stack([bidirectional_image(scene, samples, EDGES, seed) for seed in range(RUNS)])


@pytest.mark.slow
@pytest.mark.parametrize("make", [fog_in_rough_glass, smooth_glass])
def test_the_page_and_bdpt_draw_the_same_picture(
    mono: ModuleType, make: Callable[[ModuleType], Any]
) -> None:
    import render

    render.register_plugins()
    scene = make(mono)
    images = ours(mono, scene, "bdpt", 4096, max_depth=EDGES, rr_depth=100)
    check_same(page(scene, 512), images, make.__name__)


@pytest.mark.slow
def test_the_page_and_mitsubas_path_tracer_draw_the_same_picture(mono: ModuleType) -> None:
    scene = fog_in_rough_glass(mono)
    check_same(page(scene, 512), theirs(mono, scene, "volpath", 2048, max_depth=EDGES), "fog")
