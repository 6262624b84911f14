"""The flat GelSight of arXiv 2012.13184 against two linear photographs of a pressed prism.

Numbers of the photographs are those of github.com/CMURoboTouch/tactile_optical_simulation; the
scene gelsight-flat has those of the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from truth.comparison import (
    BLOCK,
    Array,
    Light,
    Row,
    between,
    by_color,
    in_blocks,
    linear,
    off,
    previewed,
    touched,
)

import tactilux
from render.scene import unchecked

FULL, CROP, PIXEL = (2592, 1944), 600, math.tan(math.radians(53.3) / 2) * 41.05 / 1296
"""Pixels of the whole picture, of the side of a photograph, and mm to a pixel on the skin."""
PINHOLE = (-1.103, 1.324)
"""x and y (mm) of the camera, in the frame of the scene gelsight-flat."""
CROPS = {"tri0u": (1324, 970), "tri1u": (1340, 972)}
"""Where the middle of each photograph is in the whole picture: ``target_settings/flatgel/cfgs``."""
CORNERS = {
    "tri0u": [(103.0, 300.0), (413.0, 128.0), (405.0, 490.0)],
    "tri1u": [(97.0, 295.0), (413.0, 122.0), (404.0, 487.0)],
}
"""Corners (pixels) of the prism that is pressed in, read off the photographs."""
MARGIN = 40
"""Pixels around the prism that are no untouched skin."""
FACETS = [1, 9, 5]
"""Facets of the scene's pyramid that face as the prism's sides do, within 3 deg: 30, 270, 150."""
WRONG = {"turned 60 deg": (60, 1), "-60": (-60, 1), "mirrored": (0, -1), "upside down": (180, -1)}
"""Lamps that are wrong on purpose: turned about the axis (deg), and the sign of their x."""


def wrong(scene: tactilux.Scene, turn: float, sign: float) -> tactilux.Scene:
    """Return the scene with its lamps turned (deg), and mirrored where ``sign`` is -1."""
    c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    matrix = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) * [sign, 1.0, 1.0]
    assert scene.lamps is not None

    def moved(vector: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(float(v) for v in matrix @ vector)

    lamps = [
        unchecked(lamp, {"position": moved(lamp.position), "direction": moved(lamp.direction)})
        for lamp in scene.lamps
    ]
    return unchecked(scene, {"lamps": tuple(lamps)})


def side(name: str, number: int) -> tuple[Array, Array, Array]:
    """Return both corners of a side of the prism in a photograph, and the unit vector outwards."""
    start, end = (np.array(CORNERS[name][(number + i) % 3]) for i in (0, 1))
    across, down = (end - start) / np.hypot(*(end - start))
    return start, end, np.array([down, -across])


def skin_places(name: str) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return x and y (mm) of the middles of blocks, and which of them show untouched skin."""
    middle = BLOCK * (np.arange(CROP // BLOCK) + 0.5)
    pixel = np.stack(np.meshgrid(middle, middle), axis=-1)
    whole = pixel + np.array(CROPS[name]) - CROP / 2 - np.array(FULL) / 2
    ends = [side(name, number) for number in range(3)]
    near = np.all([(pixel - start) @ normal < MARGIN for start, _, normal in ends], axis=0)
    return PINHOLE[0] - whole[..., 0] * PIXEL, PINHOLE[1] - whole[..., 1] * PIXEL, ~near


def skin(scene: tactilux.Scene, photographs: dict[str, Array], light: Light) -> Iterator[Row]:
    """Compare the untouched skin: at most 0.15, and wrong lamps stay above 0.30."""
    scene = touched(scene, {"columns": 8, "rows": 8, "spacing": 1.4}, faces=3, radius=0.4)
    seen = by_color(scene, light(scene)[1])
    others = {key: by_color(scene, previewed(wrong(scene, *how))[1]) for key, how in WRONG.items()}
    for name, photograph in photographs.items():
        x, y, free = skin_places(name)
        real = in_blocks(photograph)[free]
        drawn = {
            key: between(scene, values, x[free], y[free])
            for key, values in {"": seen, **others}.items()
        }
        found = {key: off(values, real) for key, values in drawn.items()}
        controls = {**found, "gray": off(np.ones_like(real), real)}
        yield Row(f"CMU skin, {name}", controls.pop(""), "<= 0.15", controls)


def peaks(photograph: Array, name: str) -> Array:
    """Return the strongest contrast of each side of the prism, ``(side, channel)``.

    Profiles across a side are means over its middle 60 %, over the straight line between the means
    of the eight pixels at either end, 60 pixels away.
    """
    across, found = np.arange(-60, 61), []
    for number in range(3):
        start, end, normal = side(name, number)
        along = start + np.linspace(0.2, 0.8, 120)[:, None] * (end - start)
        column, row = np.rint(along[:, None] + across[:, None] * normal).astype(int).T
        profile = photograph[row, column].mean(axis=1)
        low, high = profile[:8].mean(axis=0), profile[-8:].mean(axis=0)
        contrast = (profile / (low + (high - low) * ((across + 60) / 120)[:, None]) - 1)[20:-20]
        found.append(contrast[np.abs(contrast).argmax(axis=0), range(3)])
    return np.array(found)


def facet_contrasts(scene: tactilux.Scene, light: Light) -> Array:
    """Return the same of facets, means over sites on the prism's area, ``(side, channel)``."""
    around = touched(scene, {"columns": 3, "rows": 3, "spacing": 1.5}, radius=0.3)
    facets, sites = (by_color(around, part) for part in light(around))
    return np.asarray(facets[:, FACETS].mean(axis=0) / sites.mean(axis=0) - 1)


def prism(scene: tactilux.Scene, photographs: dict[str, Array], light: Light) -> Iterator[Row]:
    """Compare the contrast of three faces in three channels: nothing is fitted."""
    seen = facet_contrasts(scene, light)
    others = {key: facet_contrasts(wrong(scene, *how), previewed) for key, how in WRONG.items()}
    for name, photograph in photographs.items():
        real = peaks(photograph, name)
        signs, likeness = {}, {}
        for key, values in {"": seen, **others}.items():
            signs[key] = float((np.sign(values) == np.sign(real)).sum())
            likeness[key] = float(np.corrcoef(values.ravel(), real.ravel())[0, 1])
        yield Row(f"CMU prism, {name}: signs of 9", signs.pop(""), ">= 9", signs)
        yield Row(f"CMU prism, {name}: peaks", likeness.pop(""), ">= 0.85", likeness)


def rows(folder: Path, light: Light) -> Iterator[Row]:
    """Compare the scene gelsight-flat with two linear photographs of a prism."""
    scene = tactilux.load_scene("gelsight-flat")
    pictures = folder / "target_settings" / "flatgel" / "imgs"
    photographs = {name: linear(pictures / f"{name}.exr", False) for name in CROPS}
    yield from skin(scene, photographs, light)
    yield from prism(scene, photographs, light)
