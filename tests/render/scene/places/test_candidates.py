"""Candidates lie along their rails, like the lamps of the scene, and never in each other's way."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest

from render.scene import Rail, Scene, Search, load_scene, shipped_scenes, unchecked
from render.scene.places import KeepOut, candidates_on, usual_rails


def rail(edge: str, **keys: object) -> Rail:
    return Rail.model_construct(edge=edge, **keys)


def test_a_rail_fills_its_edge_from_end_to_end() -> None:
    digit = load_scene("digit")
    found = candidates_on(digit, [rail("left")])
    along = [one.place.along[0] for one in found]
    # 25 mm less a lamp of 1.3 mm, two diameters apart, in the middle.
    assert np.diff(along) == pytest.approx(2.6)
    assert len(along) == math.floor((25.0 - 1.3) / 2.6) + 1
    assert sum(along) == pytest.approx(0.0)
    for one in found:
        assert one.position.tolist() == pytest.approx([-9.15 - 0.7, one.place.along[0], 3.075])
        assert one.direction.tolist() == [1.0, 0.0, 0.0]


def test_a_rail_says_where_how_high_how_far_and_how_tilted() -> None:
    digit = load_scene("digit")
    tilt = math.radians(20.0)
    found = candidates_on(
        digit, [rail("right", at=(-3.0, 4.0), heights=(1.0, 3.0), gap=2.0, tilt=tilt, like=1)]
    )
    assert [(one.place.along[0], one.position[2]) for one in found] == [
        (-3.0, 1.0), (4.0, 1.0), (-3.0, 3.0), (4.0, 3.0),
    ]  # fmt: skip
    assert {one.position[0] for one in found} == {9.15 + 2.0}
    assert found[0].direction == pytest.approx([-math.cos(tilt), 0.0, math.sin(tilt)])
    assert {one.like for one in found} == {1}


def test_a_rail_mirrored_has_mirrored_places() -> None:
    digit = load_scene("digit")
    left, right = (candidates_on(digit, [rail(edge)]) for edge in ("left", "right"))
    for one, other in zip(left, right, strict=True):
        assert (one.position * [-1, 1, 1]).tolist() == other.position.tolist()
        assert (one.direction * [-1, 1, 1]).tolist() == other.direction.tolist()


@pytest.mark.parametrize("name", shipped_scenes())
def test_bodies_of_any_two_keep_apart(name: str) -> None:
    scene = load_scene(name)
    found = candidates_on(scene, usual_rails(scene))
    assert found
    lamps = scene.placed_lamps()
    least = min(lamp.diameter for lamp in lamps)
    for one in found:
        for lamp in lamps:
            assert np.linalg.norm(one.position - lamp.position) >= lamps[one.like].diameter - 1e-6
    for one, other in combinations(found, 2):
        assert np.linalg.norm(one.position - other.position) >= least - 1e-6


def searching(scene: Scene, **keys: object) -> Scene:
    return unchecked(scene, {"search": Search.model_construct(**keys)})


def test_none_lies_where_something_else_is() -> None:
    part = KeepOut.model_construct(edge="left", between=(-2.0, 5.0))
    scene = searching(load_scene("digit"), keep_out=(part,))
    along = [one.place.along[0] for one in candidates_on(scene, [rail("left")])]
    assert along
    assert all(place <= -2.0 - 0.65 or place >= 5.0 + 0.65 for place in along)


def test_bodies_may_be_told_to_keep_farther_apart() -> None:
    scene = searching(load_scene("digit"), apart=5.0)
    along = [one.place.along[0] for one in candidates_on(scene, [rail("left")])]
    assert np.diff(along).min() >= 5.0


def test_lamps_stay_behind_a_diffuser_where_there_is_one() -> None:
    assert [one.edge for one in usual_rails(load_scene("finger20"))] == ["left", "tip", "right"]
    assert [one.edge for one in usual_rails(load_scene("digit"))] == [
        "left", "tip", "right", "base",
    ]  # fmt: skip
