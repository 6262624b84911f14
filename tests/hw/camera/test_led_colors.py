"""Any LEDs before any camera: whose light each channel sees, and what miswiring looks like."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hw.camera.led_colors import exchanges, own_channels
from hw.camera.self_test import check_channels, check_order
from hw.errors import CaptureError
from render.arrays import Array
from render.scene import Palette, load_scene
from tests.hw.palettes import RESPONSES, rig_scene


@pytest.fixture
def palette(request: pytest.FixtureRequest, tmp_path: Path) -> Palette:
    return load_scene(rig_scene(tmp_path, request.param)).palette


each = pytest.mark.parametrize("palette", RESPONSES, indirect=True)
AMBER, FOUR = "white and amber, color camera", "amber, infrared and white, four channels"
INFRARED = "white and infrared, gray camera"


def rise(palette: Palette, seed: int = 0) -> Array:
    """Return counts of a rig whose channels have other gains and a little more light of all."""
    rng = np.random.default_rng(seed)
    gain = rng.uniform(0.4, 1.0, len(palette.channels))
    strength = rng.uniform(0.85, 1.15, (len(palette.names), 1))
    leak = rng.uniform(0.0, 0.08, palette.matrix.shape)
    return np.asarray(60.0 * strength * (palette.matrix + leak) * gain)


def test_a_white_led_has_all_channels_and_a_leak_is_nobodys_own() -> None:
    found = own_channels(np.array([[1.0, 1.0, 0.8], [1.0, 0.4, 0.0], [0.3, 0.2, 0.01]]))
    assert found.tolist() == [[True, True, True], [True, False, False], [True, True, False]]


@pytest.mark.parametrize("count", [1, 2, 4, 16])
def test_wires_are_exchanged_by_pairs_or_moved_along(count: int) -> None:
    orders = exchanges(count)
    pairs, moves = count * (count - 1) // 2, count - 1
    assert len(orders) == {1: 0, 2: 1}.get(count, pairs + moves)
    assert all(sorted(order) == list(range(count)) for order in orders)
    assert tuple(range(count)) not in orders


@each
@pytest.mark.parametrize("seed", range(5))
def test_healthy_rigs_pass_whatever_their_gains(palette: Palette, seed: int) -> None:
    check_channels(rise(palette, seed), palette)


@pytest.mark.parametrize("palette", [FOUR], indirect=True)
@pytest.mark.parametrize("order", exchanges(4))
def test_channels_in_another_order_are_refused(palette: Palette, order: tuple[int, ...]) -> None:
    with pytest.raises(CaptureError, match="colors arrive in the wrong channels"):
        check_channels(rise(palette)[:, list(order)], palette)


@pytest.mark.parametrize("palette", [FOUR], indirect=True)
def test_it_says_where_the_light_of_each_channel_is(palette: Palette) -> None:
    with pytest.raises(CaptureError, match="blue in red, green in green, red in blue, nir in nir"):
        check_channels(rise(palette)[:, [2, 1, 0, 3]], palette)


@pytest.mark.parametrize("palette", [AMBER, INFRARED], indirect=True)
def test_leds_that_are_wired_to_each_others_places_are_refused(palette: Palette) -> None:
    with pytest.raises(CaptureError, match="LEDs are seen as others"):
        check_channels(rise(palette)[::-1], palette)


@pytest.mark.parametrize("palette", [AMBER], indirect=True)
def test_a_color_in_channels_that_should_not_see_it_is_refused(palette: Palette) -> None:
    mixed = 60.0 * palette.matrix
    mixed[1, 2] = 35.0
    with pytest.raises(CaptureError, match="amber light also brightens other channels by up to 58"):
        check_channels(mixed, palette)


@each
def test_a_designs_colors_in_their_order_pass_and_one_swapped_fiber_is_left_to_the_check(
    palette: Palette,
) -> None:
    rng = np.random.default_rng(1)
    colors = np.arange(20) % len(palette.names)
    expected = rng.uniform(50, 200, (20, 1)) * palette.matrix[colors]
    gain = rng.uniform(0.5, 1.0, len(palette.channels))
    for fiber in (None, 3):
        lit = colors.copy()
        if fiber is not None:
            lit[fiber] = (lit[fiber] + 1) % len(palette.names)
        seen = expected.sum(axis=1, keepdims=True) / palette.matrix[colors].sum(
            axis=1, keepdims=True
        )
        noise = 0.5 * rng.standard_normal(expected.shape)
        check_order(expected, seen * palette.matrix[lit] * gain + noise, palette)
