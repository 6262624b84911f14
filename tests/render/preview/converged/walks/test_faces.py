"""What faces do to light: closed forms of what each sort of paint and the bond send back."""

from __future__ import annotations

import math

import numpy as np
import pytest

from render.preview.converged.block import bent_block
from render.preview.converged.walks import (
    BASE,
    Block,
    begin_stream,
    meet_bond,
    reflect_inside,
    uniform,
)
from render.scene import load_scene
from tests.oracles.pads import scene_of_case

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


@pytest.mark.parametrize(("degrees", "below"), [(20.0, False), (60.0, True), (80.0, True)])
def test_the_bond_refracts_by_snell_and_reflects_by_fresnel(degrees: float, below: bool) -> None:
    block = bent_block(scene_of_case("window lit from below"), 0.0, pressed=False)
    assert (block.index, block.window) == (1.41, 1.6)
    angle, (before, behind) = math.radians(degrees), (1.6, 1.41) if below else (1.41, 1.6)
    up = -1.0 if below else 1.0
    sine = before / behind * math.sin(angle)
    total = sine >= 1.0
    assert total == (degrees == 80.0)
    out = math.pi / 2 if total else math.asin(sine)
    reflectance = 1.0 if total else 0.5 * (
        (math.sin(angle - out) / math.sin(angle + out)) ** 2
        + (math.tan(angle - out) / math.tan(angle + out)) ** 2
    )  # fmt: skip
    for chance in (0.999 * reflectance, min(1.001 * reflectance, 0.9999)):
        d = np.array([0.6 * math.sin(angle), 0.8 * math.sin(angle), up * math.cos(angle)])
        side = meet_bond(block, below, d, chance)
        if total or chance < reflectance:
            assert side == below
            expected = [0.6 * math.sin(angle), 0.8 * math.sin(angle), -up * math.cos(angle)]
        else:
            assert side != below
            expected = [0.6 * math.sin(out), 0.8 * math.sin(out), up * math.cos(out)]
        np.testing.assert_allclose(d, expected, atol=1e-12)
