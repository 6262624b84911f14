"""Mirrored pairs keep to few runs, and turn as images do: brute force, and beams in a mirror."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Design, limits_of, unlimited
from optimize.design.runs import Runs, count_runs
from optimize.design.tied_directions import TiedDirections
from optimize.placement import searched_scene
from optimize.scoring import TableScorer
from optimize.search import alternating_search
from render.errors import DesignError
from render.geometry import flat_fiber_poses
from render.scene import Scene, load_scene
from render.scene.places import SIGNS, images
from render.transport import TransportTable

RING = np.array([5, 0, 1, 2, 3, 4])
TIES = np.array([0, 1, 2, 1, 0, 3])
"""Lamp 5 is its own image, 0 and 4 are images of each other, 1 and 3 too, and 2 is its own."""


def mirrored(name: str, axis: str = "x", **more: object) -> Scene:
    return load_scene(name).with_(schema=2, search={"mirror": axis, **more})


@pytest.mark.parametrize("most", [1, 2, 3, 4])
@pytest.mark.parametrize("off", [False, True])
def test_the_nearest_pairs_in_few_runs_are_those_of_brute_force(most: int, off: bool) -> None:
    limits = replace(unlimited(6, off=off), ties=TIES, runs=Runs(most, RING), most_lit=6 - off)
    product = np.array(list(itertools.product(range(-off, 3), repeat=6)))
    tied = (product[:, 0] == product[:, 4]) & (product[:, 1] == product[:, 3])
    few = (product >= 0).sum(axis=1) <= 6 - off
    allowed = tied & few & (count_runs(product[:, RING]) <= most)
    assert limits.fits(product).tolist() == allowed.tolist()
    rng = np.random.default_rng(most)
    for _ in range(20):
        worth = rng.normal(size=limits.allowed.shape)
        best = max(worth[np.arange(6), row].sum() for row in product[allowed])
        found = limits.nearest_colors(worth)
        assert limits.fits(found[None])[0]
        assert worth[np.arange(6), found].sum() == pytest.approx(best)


@pytest.mark.parametrize(("name", "axis"), [("finger20", "x"), ("digit", "x"), ("digit", "y")])
def test_the_ring_of_mirrored_lamps_is_its_own_image(name: str, axis: str) -> None:
    if name == "digit":
        rail = {"edge": "left" if axis == "x" else "tip"}
        scene = searched_scene(mirrored(name, axis, places=[rail], runs=3), lamps=4)
    else:
        scene = mirrored(name, axis, runs=3)
    limits = limits_of(scene)
    assert limits.runs is not None
    ring = limits.runs.ring.tolist()
    assert sorted(ring) == list(range(scene.lamp_count))
    pairs = images(scene.placed_lamps(), axis)
    paired = [lamp for lamp in ring if pairs[lamp] not in (None, lamp)]
    assert len(paired) >= 4
    assert [pairs[lamp] for lamp in paired] == paired[::-1]
    found = limits.nearest_colors(np.random.default_rng(0).uniform(size=limits.allowed.shape))
    assert limits.fits(found[None])[0]


def test_mirrored_lamps_of_parts_are_pairs_of_one_part() -> None:
    parts = ["red-0603", "green-0603", "ws2812b-2020"]
    asked = mirrored("digit", parts=parts, places=[{"edge": "left"}], runs=4)
    scene = searched_scene(asked, lamps=4)
    limits, rng = limits_of(scene), np.random.default_rng(1)
    lamps, names = scene.placed_lamps(), scene.palette.names
    for _ in range(5):
        colors = limits.nearest_colors(rng.uniform(size=limits.allowed.shape))
        lit = {
            (tuple(np.round(lamp.position, 6)), lamp.diameter, names[color])
            for lamp, color in zip(lamps, colors, strict=True)
            if color >= 0
        }
        assert len(lit) >= 3
        assert lit == {((-x + 0.0, y, z), wide, name) for (x, y, z), wide, name in lit}


def test_beams_of_pairs_are_images_in_a_mirror() -> None:
    scene = mirrored("finger20")
    limits, poses = limits_of(scene), flat_fiber_poses(scene)
    pairs = images(scene.placed_lamps(), "x")
    assert all(pair is not None for pair in pairs)
    phi = limits.nearest_directions(np.random.default_rng(2).uniform(0.4, 2.7, (30, 20)))
    assert limits.nearest_directions(phi) == pytest.approx(phi, abs=1e-12)
    for row in phi:
        beams = poses.directions(row)
        assert beams[list(pairs)] == pytest.approx(beams * SIGNS["x"], abs=1e-12)
    assert limits.turned.sum() == 10


def test_slopes_by_leading_directions_are_those_of_differences() -> None:
    tied = TiedDirections(np.array([0, 1, 2, 1, 0]), np.array([0, 0, 0, 1, 0], dtype=bool))
    weights = np.random.default_rng(3).normal(size=5)

    def value(phi: np.ndarray) -> float:
        return float(np.sin(tied.mirrored(phi) * weights).sum())

    at, step = np.linspace(0.3, 2.0, 5), 1e-6
    by_each = weights * np.cos(tied.mirrored(at) * weights)
    slopes = [(value(at + step * one) - value(at - step * one)) / (2 * step) for one in np.eye(5)]
    assert tied.unmirrored(by_each) == pytest.approx(slopes, abs=1e-8)


def test_a_forbidden_direction_is_forbidden_to_the_image() -> None:
    source = {"unit": "deg", "source": "test"}
    gap = {"low": {"value": 20.0, **source}, "high": {"value": 60.0, **source}, "fibers": [0]}
    scene = load_scene("finger20").with_(
        schema=2, search={"mirror": "x"}, constraints={"forbidden": [gap]}
    )
    limits, image = limits_of(scene), images(scene.placed_lamps(), "x")[0]
    assert image is not None
    found = np.degrees(limits.nearest_directions(np.full(20, math.radians(42.0))))
    # Fibers of both sides count directions from the tip, so that images turn alike.
    assert found[[0, image]] == pytest.approx([60.0, 60.0])
    assert found[1] == pytest.approx(42.0)


def test_a_search_turns_and_colors_pairs_together_to_an_optimum(
    make_table: Callable[..., TransportTable],
) -> None:
    tied = TiedDirections(np.array([0, 1, 2, 1, 0, 5]), np.array([0, 0, 0, 1, 1, 0], dtype=bool))
    limits = replace(unlimited(6), ties=TIES, tied=tied, runs=Runs(3, RING))
    scorer = TableScorer(make_table(6, 5, 1, 3, 5, lam=60.0, seed=4), limits=limits)
    start = Design.of_colors(np.full(6, 1.3), [0, 1, 2, 1, 0, 2])
    found = alternating_search(scorer, start)
    assert limits.fits(found.design.colors[None])[0]
    assert tied.mirrored(found.design.phi) == pytest.approx(found.design.phi, abs=1e-12)
    assert found.score > scorer.score(tied.mirrored(start.phi), start.power)
    rng = np.random.default_rng(0)
    near = np.clip(found.design.phi + rng.normal(0.0, 0.02, (200, 6)), 0.0, np.pi)
    scores = [scorer.score(phi, found.design.power) for phi in limits.nearest_directions(near)]
    assert max(scores) <= found.score + 1e-3 * abs(found.score)


@pytest.mark.parametrize(
    ("constraints", "said"),
    [
        ({"angle_step": {"value": 25.0, "unit": "deg", "source": "test"}},
         "angle_step = 25 deg, but search.mirror turns images the other way, allowed: a step"),
        ({"fixed": [{"fiber": 0, "angle": {"value": 40.0, "unit": "deg", "source": "test"}},
                    {"fiber": 19, "angle": {"value": 41.0, "unit": "deg", "source": "test"}}]},
         "lamps 0 and 19 are images of each other, but no direction of one is allowed"),
    ],
)  # fmt: skip
def test_directions_that_no_image_can_have_are_refused(
    constraints: dict[str, object], said: str
) -> None:
    scene = load_scene("finger20").with_(schema=2, search={"mirror": "x"}, constraints=constraints)
    with pytest.raises(DesignError) as refused:
        limits_of(scene)
    assert said in str(refused.value)
