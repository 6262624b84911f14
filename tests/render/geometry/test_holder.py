"""Fibers that would meet in the wall that holds them are known, and told."""

from __future__ import annotations

import numpy as np
import pytest

from render.describe import describe
from render.geometry import FiberHolder, flat_fiber_poses
from render.scene import Scene, load_scene, unchecked


@pytest.fixture(scope="module")
def finger20() -> Scene:
    return load_scene("finger20")


def with_fibers(scene: Scene, **counts: int) -> Scene:
    return unchecked(scene, {"fibers": unchecked(scene.fibers, counts)})


def test_walls_are_what_cylinders_along_the_beams_leave(finger20: Scene) -> None:
    """The holes' rims, by intersecting their cylinders with the faces of the wall."""
    holder, poses = FiberHolder.of(finger20), flat_fiber_poses(finger20)
    phi = np.random.default_rng(1).uniform(0.6, 2.5, 20)
    beams = poses.directions(phi)
    turn = np.linspace(0.0, 2 * np.pi, 2000)
    low, high = np.zeros((2, 20)), np.zeros((2, 20))
    for f in range(8):  # the left edge: along y, into the pad along x
        side = np.cross(beams[f], [0.0, 0.0, 1.0])
        side /= np.linalg.norm(side)
        ring = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(beams[f], side)
        ring *= holder.hole[f] / 2
        for face, x in enumerate((0.0, -holder.thickness)):
            rim = ring + ((x - ring[:, 0]) / beams[f, 0])[:, None] * beams[f]
            y = poses.position[f, 1] + rim[:, 1]
            low[face, f], high[face, f] = y.min(), y.max()
    between = (low[:, 1:8] - high[:, :7]).min(axis=0)
    assert holder.walls(phi)[:7] == pytest.approx(between, abs=1e-4)
    miter = 15.0 + 2.4 + np.array([0.0, holder.thickness])
    assert holder.walls(phi)[7] == pytest.approx((miter - high[:, 7]).min(), abs=1e-4)


@pytest.mark.parametrize("left", [8, 24, 40])
def test_upright_fibers_fit_however_close(finger20: Scene, left: int) -> None:
    dense = with_fibers(finger20, left=left)
    holder = FiberHolder.of(dense)
    assert not list(holder.problems(np.full(dense.lamp_count, np.pi / 2)))


@pytest.mark.parametrize(("first", "flip"), [(3, 1), (9, 1), (15, -1)])
def test_neighbors_that_cross_behind_their_ends_are_named(
    finger20: Scene, first: int, flip: int
) -> None:
    holder, phi = FiberHolder.of(finger20), np.full(20, np.pi / 2)
    away = flip * np.radians(50.0)  # the beams part, so the fibers meet
    phi[first], phi[first + 1] = np.pi / 2 + away, np.pi / 2 - away
    problems = list(holder.problems(phi))
    assert [problem.split(":")[0] for problem in problems if " and " in problem] == [
        f"fibers {first} and {first + 1} at {90 + flip * 50} and {90 - flip * 50} deg meet in a "
        "holder 3 mm thick"
    ]
    assert np.flatnonzero(holder.crowded(phi)).tolist() == [first, first + 1]
    phi[first : first + 2] = np.pi / 2 - away / 3, np.pi / 2 + away / 3
    assert not list(holder.problems(phi))  # beams that cross leave their fibers apart


def test_a_fiber_may_meet_the_corner(finger20: Scene) -> None:
    holder, phi = FiberHolder.of(finger20), np.full(20, np.pi / 2)
    phi[7] = np.radians(165.0)
    (problem,) = holder.problems(phi)
    assert problem.startswith("fiber 7 at 165 deg meets the corner")
    phi[7] = np.radians(15.0)  # back to the base, into its neighbor
    (problem,) = holder.problems(phi)
    assert problem.startswith("fibers 6 and 7 at 90 and 15 deg meet")


def test_a_mirrored_design_leaves_the_mirrored_walls(finger20: Scene) -> None:
    holder = FiberHolder.of(finger20)
    phi = np.random.default_rng(3).uniform(0.0, np.pi, 20)
    mirrored = phi[::-1].copy()
    mirrored[8:12] = np.pi - mirrored[8:12]
    assert holder.walls(mirrored) == pytest.approx(holder.walls(phi)[::-1])


def test_a_single_fiber_meets_nobody(finger20: Scene) -> None:
    alone = with_fibers(finger20, left=0, tip=0, right=1)
    assert not list(FiberHolder.of(alone).problems(np.full(1, np.pi / 2)))


def test_describe_says_what_searches_keep_to(finger20: Scene) -> None:
    text = describe(finger20).text()
    assert "fibers do not meet in the holder around the pad, 3 mm thick" in text
