"""Powers become levels of the right LEDs, and never more than the rig may draw."""

from __future__ import annotations

import numpy as np
import pytest

from hw.errors import PowerError
from hw.leds.channels import ChannelMap, PowerLimits

POWER = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.2]])


def test_each_fiber_lights_its_own_led() -> None:
    levels = ChannelMap((4, 0, 2)).levels(POWER, PowerLimits())
    assert levels.tolist() == [[0, 128, 0], [0, 0, 0], [0, 0, 51], [0, 0, 0], [255, 0, 0]]


def test_channels_are_sent_in_the_order_of_the_wiring() -> None:
    levels = ChannelMap.straight(3, order="grb").levels(POWER, PowerLimits())
    assert levels.tolist() == [[0, 255, 0], [128, 0, 0], [0, 0, 51]]


def test_six_colors_take_two_leds_per_fiber_and_one_takes_one() -> None:
    six = np.zeros((2, 6))
    six[0, 4], six[1, 0], six[1, 5] = 1.0, 0.2, 0.4
    levels = ChannelMap((1, 0), "grb", 6).levels(six, PowerLimits())
    assert levels.tolist() == [[0, 51, 0], [0, 0, 102], [0, 0, 0], [255, 0, 0]]
    mono = ChannelMap.straight(2, colors=1)
    assert mono.levels(np.array([[1.0], [0.4]]), PowerLimits()).tolist() == [
        [255, 0, 0],
        [102, 0, 0],
    ]
    with pytest.raises(PowerError, match=r"allowed: \(2, 1\) in 0 to 1"):
        mono.levels(six, PowerLimits())


def test_too_much_current_is_refused_and_not_dimmed() -> None:
    limits = PowerLimits(total_milliamperes=30)
    with pytest.raises(PowerError, match="34 mA, allowed: 30 mA; lower --scale"):
        ChannelMap.straight(3).levels(POWER, limits)


def test_power_that_is_not_a_number_is_refused() -> None:
    with pytest.raises(PowerError):
        ChannelMap.straight(3).levels(POWER * np.nan, PowerLimits())


@pytest.mark.parametrize("text", ["0,1", "0,1,x", "", "0,1,2,3"])
def test_a_map_needs_one_led_per_fiber(text: str) -> None:
    with pytest.raises(PowerError, match="list of 3 numbers"):
        ChannelMap.parse(text, 3, "rgb")


@pytest.mark.parametrize("leds", [(0, 1, 1), (0, -1, 2)])
def test_one_led_cannot_feed_two_fibers(leds: tuple[int, ...]) -> None:
    with pytest.raises(PowerError, match="--leds"):
        ChannelMap(leds)


def test_an_unknown_order_is_refused() -> None:
    with pytest.raises(PowerError, match="grb"):
        ChannelMap((0,), "rgw")
