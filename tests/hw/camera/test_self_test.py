"""Swapped channels and stray light are noticed before anything is measured."""

from __future__ import annotations

import numpy as np
import pytest

from hw.camera.self_test import check_channels
from hw.errors import CaptureError

GOOD = np.array([[50.0, 4.0, 1.0], [3.0, 60.0, 5.0], [0.0, 6.0, 40.0]])


def test_colors_in_their_own_channels_pass() -> None:
    check_channels(GOOD)


def test_swapped_channels_are_named() -> None:
    with pytest.raises(CaptureError, match=r"red in B, green in G, blue in R.*--order to bgr"):
        check_channels(GOOD[:, ::-1])


def test_a_cycle_of_channels_is_undone_by_the_order_that_is_named() -> None:
    # Red arrives in G, green in B, blue in R: sending (b, r, g) puts each where it belongs.
    with pytest.raises(CaptureError, match="--order to brg"):
        check_channels(np.roll(GOOD, 1, axis=1))


def test_mixed_colors_are_refused() -> None:
    with pytest.raises(CaptureError, match="color correction"):
        check_channels(GOOD + 45.0)


def test_no_light_is_refused() -> None:
    with pytest.raises(CaptureError, match="LEDs are on"):
        check_channels(0.01 * GOOD)
