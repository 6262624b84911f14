"""Painted edges in compiled paths: closed forms of what each sort of paint sends back."""

from __future__ import annotations

import math

import numpy as np
import pytest

from render.preview.converged.block import bent_block
from render.preview.converged.walks import BASE, Block, begin_stream, reflect_inside, uniform
from render.scene import load_scene

MET, COUNT = 0.6, 20_000
INWARD = np.array([0.0, 1.0, 0.0])


def block_with(reflectance: float, mirror: bool) -> Block:
    block = bent_block(load_scene("finger20"), 0.0, pressed=False)
    block.paint[BASE] = reflectance, float(mirror)
    return block


def sent_back(block: Block) -> np.ndarray:
    """Return directions after light met the base, ``(path, 3)``; of what was absorbed NaN."""
    state, m = np.zeros(1, np.uint64), np.empty(3)
    out = np.full((COUNT, 3), np.nan)
    begin_stream(state, 7, 0)
    for path in range(COUNT):
        d = np.array([math.sqrt(1.0 - MET**2), -MET, 0.0])
        u, v, chance = uniform(state), uniform(state), uniform(state)
        if reflect_inside(block, BASE, block.index, d, INWARD, u, v, chance, m) > 0.0:
            out[path] = d
    return out


def test_black_paint_sends_nothing_back() -> None:
    assert np.isnan(sent_back(block_with(0.0, False))).all()


def test_a_mirror_sends_its_reflectance_back_the_mirrored_way() -> None:
    back = sent_back(block_with(0.8, True))
    kept = back[~np.isnan(back[:, 0])]
    assert len(kept) / COUNT == pytest.approx(0.8, abs=0.015)
    np.testing.assert_allclose(kept, np.tile([0.8, MET, 0.0], (len(kept), 1)), atol=1e-12)


def test_white_paint_sends_its_albedo_back_with_a_mean_cosine_of_two_thirds() -> None:
    back = sent_back(block_with(0.9, False))
    kept = back[~np.isnan(back[:, 0])]
    assert len(kept) / COUNT == pytest.approx(0.9, abs=0.015)
    # Lambert: the density cos / pi has the mean cosine 2/3, and no direction along the face.
    assert kept[:, 1].min() >= 0.0
    assert kept[:, 1].mean() == pytest.approx(2 / 3, abs=0.01)
    np.testing.assert_allclose(kept[:, [0, 2]].mean(axis=0), 0.0, atol=0.02)
