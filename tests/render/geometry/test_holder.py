"""Fibers that would meet in the wall that holds them are known, and told."""

from __future__ import annotations

import numpy as np
import pytest

from render.describe import describe
from render.geometry import FiberHolder
from render.scene import Scene, load_scene


@pytest.fixture(scope="module")
def finger20() -> Scene:
    return load_scene("finger20")


def with_fibers(scene: Scene, **counts: int) -> Scene:
    return scene.model_copy(update={"fibers": scene.fibers.model_copy(update=counts)})


def test_distances_are_those_of_points_along_the_axes(finger20: Scene) -> None:
    holder, rng = FiberHolder.of(finger20), np.random.default_rng(1)
    phi = rng.uniform(0.3, np.pi - 0.3, (5, 20))
    ends = holder.outer_ends(phi)
    t = np.linspace(0.0, 1.0, 1001)[:, None]
    for row in range(5):
        for i in range(19):
            points = [(1 - t) * holder.position[f] + t * ends[row, f] for f in (i, i + 1)]
            apart = np.linalg.norm(points[0][:, None] - points[1][None], axis=-1).min()
            assert holder.distances(phi)[row, i] == pytest.approx(apart, abs=0.01)


def test_an_axis_goes_through_the_whole_wall_against_its_beam(finger20: Scene) -> None:
    holder = FiberHolder.of(finger20)
    phi = np.full(20, np.radians(60.0))
    way = holder.outer_ends(phi) - holder.position
    assert -(way * holder.inward).sum(axis=1) == pytest.approx(np.full(20, 3.0))
    assert -(way * holder.along).sum(axis=1) == pytest.approx(np.full(20, 3.0 / np.tan(phi[0])))


@pytest.mark.parametrize("left", [8, 24, 40])
def test_upright_fibers_fit_however_close(finger20: Scene, left: int) -> None:
    dense = with_fibers(finger20, left=left)
    holder = FiberHolder.of(dense)
    assert not list(holder.problems(np.full(dense.fibers.count, np.pi / 2)))


def test_neighbors_that_cross_behind_their_ends_are_named(finger20: Scene) -> None:
    holder, phi = FiberHolder.of(finger20), np.full(20, np.pi / 2)
    phi[3], phi[4] = np.radians(140.0), np.radians(40.0)  # the beams part, so the fibers meet
    (problem,) = holder.problems(phi)
    assert "fibers 3 and 4 at 140 and 40 deg leave -0.75 mm between them" in problem
    assert "a holder of 3 mm, needed: at least 0.30 mm" in problem
    phi[3], phi[4] = np.radians(60.0), np.radians(120.0)
    assert not list(holder.problems(phi))  # beams that cross leave their fibers apart


def test_fibers_of_two_edges_may_meet_at_the_corner(finger20: Scene) -> None:
    crowded = with_fibers(finger20, left=20, tip=20)
    holder, phi = FiberHolder.of(crowded), np.full(48, np.pi / 2)
    phi[19], phi[20] = np.radians(170.0), np.radians(10.0)
    assert (holder.slack(phi) < 0).nonzero()[0].tolist() == [19]


def test_a_single_fiber_meets_nobody(finger20: Scene) -> None:
    alone = with_fibers(finger20, left=1, tip=0, right=0)
    assert not list(FiberHolder.of(alone).problems(np.zeros(1)))


def test_describe_says_what_searches_keep_to(finger20: Scene) -> None:
    text = describe(finger20).text()
    assert "neighboring fibers leave 0.3 mm between them in a holder 3 mm thick" in text
