"""Fiber images spend all light paths on few directions, and have enough points of light."""

from __future__ import annotations

import numpy as np
import pytest

from hw.calibration.material_table import FEW, few_nodes, line_light
from hw.calibration.reference_lines import Setup
from render.errors import RenderError
from render.preview import compute_response, fiber_end_of, slab_of
from render.preview.diffuser.basis import moments
from render.scene import load_scene, unchecked
from tests.long import LONG


def test_one_direction_is_its_own_node() -> None:
    nodes = few_nodes(np.full(20, np.pi / 2))
    assert nodes is not None
    assert nodes.tolist() == [np.pi / 2]


def test_a_slanted_direction_brings_its_mirror_image() -> None:
    nodes = few_nodes(np.full(20, 1.0))
    assert nodes is not None
    np.testing.assert_allclose(nodes, [1.0, np.pi - 1.0])


def test_many_directions_are_left_to_interpolation() -> None:
    assert few_nodes(np.linspace(0.3, 2.0, FEW + 1)) is None


@pytest.mark.slow
def test_few_nodes_agree_with_all() -> None:
    scene = load_scene("finger20")
    slab, beam = slab_of(scene), fiber_end_of(scene)
    middle = np.array([np.pi / 2])
    whole = compute_response(slab, beam, rays=30_000, seed=1)
    alone = compute_response(slab, beam, rays=30_000, seed=2, phi=middle)
    assert alone.power(middle)[0] == pytest.approx(whole.power(middle)[0], rel=0.03)
    seeds = range(8 if LONG else 4)
    several = [
        compute_response(slab, beam, rays=4_000, seed=s, phi=middle).power(middle)[0] for s in seeds
    ]
    spread = [compute_response(slab, beam, rays=4_000, seed=s).power(middle)[0] for s in seeds]
    assert np.std(several) < np.std(spread)


def test_light_that_is_spread_upwards_keeps_its_power_and_direction() -> None:
    scene = load_scene("finger20")
    response = compute_response(slab_of(scene), fiber_end_of(scene), rays=30_000, seed=1, heights=5)
    spread = response.spread_upwards(12)
    assert spread.radiance.shape[2] == len(spread.heights) == 12
    assert spread.heights[0] < response.heights[0]
    phi = np.array([0.7, np.pi / 2])
    np.testing.assert_allclose(spread.power(phi), response.power(phi), rtol=1e-5)
    # A polynomial over the height keeps the middle of the light.
    power = [one.at(phi).sum(axis=1) @ moments()[0] for one in (response, spread)]
    np.testing.assert_allclose(power[1] @ spread.heights, power[0] @ response.heights, rtol=1e-3)


def test_nodes_that_are_not_symmetric_are_refused() -> None:
    scene = load_scene("finger20")
    with pytest.raises(RenderError, match="symmetric"):
        compute_response(slab_of(scene), fiber_end_of(scene), rays=100, phi=np.array([1.0]))


@pytest.mark.slow
def test_more_points_of_light_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, bends = load_scene("finger20"), np.array([0.0, np.pi / 2])
    few = unchecked(scene.fibers, {"left": 1, "tip": 1, "right": 1})
    scene = unchecked(scene, {"fibers": few})
    setup = Setup(scene, np.full(3, np.pi / 2), bends)
    pixels = setup.line_pixels(200, 120)

    def drawn() -> np.ndarray:
        return np.log(line_light(setup, pixels=pixels, rays=30_000, seed=3))

    usual = drawn()
    monkeypatch.setattr("hw.calibration.material_table.HEIGHTS", 32)
    difference = drawn() - usual
    assert np.nanmax(np.abs(difference)) < 0.015
    assert np.sqrt(np.nanmean(difference**2)) < 0.002
