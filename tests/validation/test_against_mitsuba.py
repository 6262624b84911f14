"""Mitsuba's own ``path`` and ``volpath`` find the same light in rooms that they can render."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.validation.film import LONG, camera, check_same, diffuse, gray, ours, theirs
from tests.validation.rooms import ball, glass, milk, room

SPP, THEIR_SPP = (32768, 4096) if LONG else (1024, 64)
# A mutation costs several times a plain sample.
SPP_OF = {"bdpt": SPP, "pssmlt": SPP // 4}


def cornell(mi: ModuleType) -> Any:
    return mi.load_dict(
        mi.cornell_box() | {"sensor": camera(mi, [0, 0, 3.9], fov=30, target=(0, -0.3, 0))}
    )


def all_rough(mi: ModuleType) -> Any:
    """Rough glass, milk in rough glass, and fog without a boundary; three kinds of emitters."""
    return room(
        mi, point=True, glass=ball(0.0, glass(0.3)), milk=ball(1.3, glass(0.3), milk(mi)),
        fog=ball(-1.3, {"type": "null"}, milk(mi, 1.0, -0.4)),
    )  # fmt: skip


def all_smooth(mi: ModuleType) -> Any:
    """Smooth glass, and milk in smooth glass."""
    return room(mi, point=False, glass=ball(-0.7, glass(0.0)), milk=ball(0.7, glass(0.0), milk(mi)))


def floor_under_milk(mi: ModuleType) -> Any:
    """A floor behind a pane, lit through thin milk in smooth glass alone.

    Of the light that is scattered once, only a camera subpath that passes the milk can know.
    """
    transform = mi.ScalarTransform4f()
    origin, target = [0, -3, 1.75], [0, -0.5, 0]
    toward = {"target": target, "up": [0, 0, 1]}
    sensor = camera(mi, origin, fov=40) | {"to_world": transform.look_at(origin=origin, **toward)}
    medium = {
        "type": "homogeneous", "albedo": 0.8, "sigma_t": 1.5, "phase": {"type": "hg", "g": 0.3},
    }  # fmt: skip
    black = diffuse(mi, 0.0)
    return mi.load_dict(
        {
            "type": "scene",
            "floor": {
                "type": "rectangle", "to_world": transform.scale(3), "bsdf": diffuse(mi, 0.8),
            },
            "milk": {
                "type": "sphere", "center": [0, 0, 1.2], "radius": 0.65, "bsdf": glass(0.0),
                "interior": medium,
            },
            "lamp": {
                "type": "disk", "bsdf": black,
                "to_world": transform.translate([0, 0, 2.4]).rotate([1, 0, 0], 180).scale(0.6),
                "emitter": {"type": "area", "radiance": gray(mi, 10.0)},
            },
            "tube": {
                "type": "cylinder", "p0": [0, 0, 1.4], "p1": [0, 0, 2.5], "radius": 0.61,
                "bsdf": {"type": "twosided", "bsdf": black},
            },
            "pane": {
                "type": "rectangle", "bsdf": {"type": "thindielectric", "int_ior": 1.5},
                "to_world": transform.look_at(origin=[0, -2.5, 1.4], **toward).scale(1.5),
            },
            "sensor": sensor,
        }
    )  # fmt: skip


FAST: dict[str, Callable[[ModuleType], Any]] = {
    "cornell box": cornell,
    "rough glass, milk in it, fog": all_rough,
    "smooth glass, milk in it": all_smooth,
}
ONE_BY_ONE: dict[str, Callable[[ModuleType], Any]] = {
    "smooth glass": lambda mi: room(mi, point=False, ball=ball(0.0, glass(0.0))),
    "rough glass": lambda mi: room(mi, point=True, ball=ball(0.0, glass(0.3))),
    "slightly rough glass": lambda mi: room(mi, point=True, ball=ball(0.0, glass(0.1))),
    "fog": lambda mi: room(mi, point=True, ball=ball(0.0, {"type": "null"}, milk(mi))),
    "milk in rough glass": lambda mi: room(mi, point=True, ball=ball(0.0, glass(0.3), milk(mi))),
    "milk in smooth glass": lambda mi: room(mi, point=False, ball=ball(0.0, glass(0.0), milk(mi))),
}
ROOMS = FAST | (ONE_BY_ONE if LONG else {})


@pytest.fixture(scope="module", params=list(ROOMS))
def lit(request: pytest.FixtureRequest, mono: ModuleType) -> tuple[str, Any, np.ndarray]:
    """Return a room's name, its scene, and independent images of it by Mitsuba."""
    scene = ROOMS[request.param](mono)
    kind = "path" if "cornell" in request.param else "volpath"
    return request.param, scene, theirs(mono, scene, kind, THEIR_SPP)


@pytest.mark.parametrize("kind", ["bdpt", "pssmlt"])
def test_a_room_is_as_bright_as_mitsuba_finds_it(
    mono: ModuleType, lit: tuple[str, Any, np.ndarray], kind: str
) -> None:
    name, scene, truth = lit
    if kind == "pssmlt" and "rough" not in name and not LONG:
        pytest.skip("part of make validation-long")
    check_same(ours(mono, scene, kind, SPP_OF[kind]), truth, f"{name}, {kind}")


@pytest.mark.parametrize("kind", ["bdpt", "pssmlt"] if LONG else ["bdpt"])
def test_light_that_smooth_milk_scatters_once_reaches_a_floor_behind_a_pane(
    mono: ModuleType, kind: str
) -> None:
    scene = floor_under_milk(mono)
    truth = theirs(mono, scene, "volpath", 32 * THEIR_SPP)
    check_same(ours(mono, scene, kind, 4 * SPP), truth, f"floor under smooth milk, {kind}", size=4)


def test_large_steps_alone_give_the_picture_of_plain_monte_carlo(mono: ModuleType) -> None:
    scene = all_rough(mono)
    large = ours(mono, scene, "pssmlt", SPP // 4, seed=3, p_large=1.0)
    check_same(large, ours(mono, scene, "bdpt", SPP // 2, seed=4), "p_large 1 against bdpt")
