"""Where rays meet the faces of a bent block, against small steps along them."""

from __future__ import annotations

import numpy as np
import pytest

from render.preview.converged.block import bent_block
from render.preview.converged.walks import BASE, LEFT, LOWER, NONE, RIGHT, TIP, Block
from render.preview.converged.walks.crossings import COATING, cross_clear, enter_block, within
from render.scene import load_scene

STEP, RAYS = 1e-3, 60
DISTANCES = STEP * np.arange(80_000)


def block_at(degrees: float) -> Block:
    return bent_block(load_scene("finger20"), np.radians(degrees), pressed=False)


def past_faces(block: Block, points: np.ndarray, rims: bool) -> dict[int, np.ndarray]:
    """Return how far points are beyond each face, by their angle and radius about the axis.

    Faces are those of the clear pad, or those around it and the ``rims`` of the layer.
    """
    x, v, w = points.T
    depth, angle = w, np.zeros_like(w)
    if block.kappa > 0.0:
        depth = np.hypot(v, w + 1 / block.kappa) - 1 / block.kappa
        angle = np.arctan2(v, w + 1 / block.kappa)
    thickness = load_scene("finger20").pad.thickness
    ends = {BASE: block.start if rims else block.base, TIP: block.end if rims else block.tip}
    if block.kappa > 0.0:
        along = {face: angle - np.arctan2(end[1], end[0]) for face, end in ends.items()}
    else:
        along = {face: v - end[2] for face, end in ends.items()}
    rim = block.rims if rims else np.zeros(4)
    return {
        COATING: -depth,
        LOWER: depth - thickness,
        RIGHT: x - block.half_width - rim[RIGHT],
        LEFT: -x - block.half_width - rim[LEFT],
        BASE: -along[BASE],
        TIP: along[TIP],
    }


def directions(rng: np.random.Generator) -> np.ndarray:
    d = rng.normal(size=(RAYS, 3))
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


@pytest.mark.parametrize("degrees", [0.0, 60.0])
def test_a_ray_in_the_pad_meets_the_face_that_small_steps_leave_it_through(degrees: float) -> None:
    block, rng = block_at(degrees), np.random.default_rng(5)
    met: set[int] = set()
    for d in directions(rng):
        start = np.array([0.0, 0.0, 1.0]) + rng.uniform(-0.9, 0.9, 3)
        past = past_faces(block, start + DISTANCES[:, None] * d, rims=False)
        first = {face: np.argmax(far > 0.0) for face, far in past.items() if (far > 0.0).any()}
        face = min(first, key=lambda each: first[each])
        way, found, site, _ = cross_clear(block, False, start, d)
        assert (found, site) == (face, -1)
        assert DISTANCES[first[face] - 1] - 1e-9 <= way <= DISTANCES[first[face]] + 1e-9
        met.add(found)
    assert {COATING, LOWER} < met


@pytest.mark.parametrize("degrees", [0.0, 60.0])
def test_a_ray_in_the_air_enters_where_small_steps_find_the_block(degrees: float) -> None:
    block, rng = block_at(degrees), np.random.default_rng(6)
    entered = over_an_end = 0
    for d in directions(rng):
        start = np.array([0.0, 0.0, 1.0]) + rng.uniform(-6.0, 6.0, 3) - 30.0 * d
        past = past_faces(block, start + DISTANCES[:, None] * d, rims=True)
        inside = np.max(list(past.values()), axis=0) < 0.0
        p = start.copy()
        face = enter_block(block, p, d)
        if face == NONE:
            # A corner may be cut by less than the steps see; light may come over an end.
            if inside.sum() >= 3:
                assert past[COATING][0] < 0.0 < past[COATING][np.argmax(inside) - 1]
                over_an_end += 1
            continue
        entered += 1
        assert within(block, p)
        if inside.any():
            assert np.linalg.norm(p - start) == pytest.approx(
                DISTANCES[np.argmax(inside)], abs=1.01 * STEP
            )
    assert RAYS // 4 < entered < RAYS
    assert over_an_end <= (0 if degrees == 0.0 else 0.05 * RAYS)
