"""The share of a lamp's light that meets the pad, and of its end that stands before its face."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from render.geometry.lamp_reach import light_shares, shares_before_face
from render.scene import Scene
from tests.oracles.pads import BASE, MM, in_file_form, listed

NONE = ("", "test")


def scene_with(*lamps: dict[str, Any], **pad: Any) -> Scene:
    content: dict[str, Any] = {part: dict(values) for part, values in BASE.items()}
    del content["fibers"]
    content["baseline"] = {"lamps": ["red"] * len(lamps)}
    content["pad"] |= {name: (value, MM) for name, value in pad.items()}
    content["lamps"] = list(lamps)
    return Scene.model_validate({"schema": 2, "name": "case"} | in_file_form(content))


def test_the_share_of_a_small_lamp_under_the_pad_is_that_of_a_cosine_lobe_in_a_square() -> None:
    # Lambertian, 8 mm below the middle of a square: view factor of a square from a point.
    lamp = listed(0.0, 0.0, -8.0, 0.0, 0.0, 1.0) | {"diameter": (0.05, MM), "profile": "lambertian"}
    scene = scene_with(lamp, width=16.0, length=16.0)
    ratio = 1.0  # half a side over the distance
    quarter = 2 * ratio / np.sqrt(1 + ratio**2) * np.arctan(ratio / np.sqrt(1 + ratio**2))
    (share,) = light_shares(scene)
    assert share == pytest.approx(4 * quarter / (2 * np.pi), abs=0.003)


def test_a_lamp_that_shines_beside_the_pad_lights_nothing_and_one_inside_lights_all() -> None:
    beside = listed(-12.0, 0.0, -3.0, 0.0, 0.0, 1.0) | {"profile": {"sigma_v": (3.0, "deg")}}
    inside = listed(0.0, 0.0, 1.5, 0.0, 0.0, 1.0)
    shares = light_shares(scene_with(beside, inside, width=16.0, length=20.0))
    assert shares[0] < 1e-3
    assert shares[1] == 1.0


def test_a_lamp_that_turns_counts_in_its_best_direction() -> None:
    ahead = listed(-12.0, 0.0, 2.0, 1.0, 0.0, 0.0) | {"profile": {"sigma_v": (5.0, "deg")}}
    # At 90 deg it shines along the edge; some 90 deg on, into the pad.
    turned = listed(-12.0, 0.0, 2.0, 0.0, 1.0, 0.0) | {
        "profile": {"sigma_v": (5.0, "deg")}, "turns": True,
    }  # fmt: skip
    shares = light_shares(scene_with(ahead, turned))
    assert shares[1] == pytest.approx(shares[0], abs=0.005)
    assert light_shares(scene_with(turned | {"turns": False}))[0] < 0.5 * shares[1]


def test_half_of_an_end_at_the_border_of_its_face_stands_beside_it() -> None:
    lower = listed(-8.0, 0.0, -2.0, 0.0, 0.0, 1.0) | {"diameter": (1.0, MM)}
    middle = listed(0.0, 0.0, -2.0, 0.0, 0.0, 1.0) | {"diameter": (1.0, MM)}
    half, whole = shares_before_face(scene_with(lower, middle, width=16.0, length=20.0))
    assert half == pytest.approx(0.5, abs=0.02)
    assert whole == 1.0
