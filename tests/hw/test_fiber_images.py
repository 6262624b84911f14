"""Fiber images of one direction spend all light paths on it."""

from __future__ import annotations

import numpy as np
import pytest

from hw.fiber_images import FEW, _few_nodes
from render.errors import RenderError
from render.scene import load_scene
from render.slab import beam_of, slab_of
from render.slab_response import compute_response


def test_one_direction_is_its_own_node() -> None:
    nodes = _few_nodes(np.full(20, np.pi / 2))
    assert nodes is not None
    assert nodes.tolist() == [np.pi / 2]


def test_a_slanted_direction_brings_its_mirror_image() -> None:
    nodes = _few_nodes(np.full(20, 1.0))
    assert nodes is not None
    np.testing.assert_allclose(nodes, [1.0, np.pi - 1.0])


def test_many_directions_are_left_to_interpolation() -> None:
    assert _few_nodes(np.linspace(0.3, 2.0, FEW + 1)) is None


def test_few_nodes_agree_with_all() -> None:
    scene = load_scene("finger20")
    slab, beam = slab_of(scene), beam_of(scene)
    middle = np.array([np.pi / 2])
    whole = compute_response(slab, beam, rays=30_000, seed=1)
    alone = compute_response(slab, beam, rays=30_000, seed=2, phi=middle)
    assert alone.power(middle)[0] == pytest.approx(whole.power(middle)[0], rel=0.03)
    several = [
        compute_response(slab, beam, rays=4_000, seed=s, phi=middle).power(middle)[0]
        for s in range(8)
    ]
    spread = [compute_response(slab, beam, rays=4_000, seed=s).power(middle)[0] for s in range(8)]
    assert np.std(several) < np.std(spread)


def test_nodes_that_are_not_symmetric_are_refused() -> None:
    scene = load_scene("finger20")
    with pytest.raises(RenderError, match="symmetric"):
        compute_response(slab_of(scene), beam_of(scene), rays=100, phi=np.array([1.0]))
