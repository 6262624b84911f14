"""Palettes that are not red, green and blue, for tests of rigs: LEDs, channels, baselines."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.colored_scenes import with_palette

RESPONSES = {
    "white, gray camera": {"white": [1.0]},
    "white and infrared, gray camera": {"white": [1.0], "infrared": [0.4]},
    "white and amber, color camera": {"white": [0.9, 1.0, 0.8], "amber": [1.0, 0.4, 0.0]},
    "amber, infrared and white, four channels": {
        "amber": [0.0, 0.4, 1.0, 0.1],
        "infrared": [0.05, 0.05, 0.1, 0.9],
        "white": [0.9, 1.0, 0.8, 0.05],
    },
    "red, green, blue and white, color camera": {
        "red": [1.0, 0.0, 0.0],
        "green": [0.0, 1.0, 0.0],
        "blue": [0.0, 0.0, 1.0],
        "white": [1.0, 1.0, 1.0],
    },
}
"""What channels see of each LED color, by the palette's description."""
CHANNELS = {1: ("gray",), 3: None, 4: ("blue", "green", "red", "nir")}


def matrix(name: str) -> np.ndarray:
    """Return a palette's response ``(color, channel)``."""
    return np.array(list(RESPONSES[name].values()))


def rig_scene(folder: Path, name: str, sensor: str = "digit") -> Path:
    """Return the file of a sensor of three lamps, or edges, lit by a palette's LEDs in turn."""
    leds = RESPONSES[name]
    first, second, third = (list(leds)[number % len(leds)] for number in range(3))
    baseline = f'tip = "{first}"\nlamps = ["{second}", "{third}"]'
    if sensor != "digit":
        baseline = f'left = "{first}"\ntip = "{second}"\nright = "{third}"'
    return with_palette(folder, sensor, leds, baseline, CHANNELS[len(next(iter(leds.values())))])
