"""What the comparisons share: rows of the table, light of a scene, pictures in blocks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

import tactilux
from render.scene import unchecked

Array = NDArray[np.float64]
Light = Callable[[tactilux.Scene], tuple[Array, Array]]
"""What facets and untouched sites of a scene send to the camera: `previewed` or `rendered`."""
BLOCK = 16
"""Pixels along the side of the blocks by which pictures are compared."""
COLORS = ("red", "green", "blue")


@dataclass(frozen=True)
class Row:
    """A line of the table: what is compared, what was found, the goal, wrong lights beside it.

    ``goal`` is "<= number" or ">= number"; ``controls`` are the same figure where the lights are
    wrong on purpose.
    """

    what: str
    found: float
    goal: str
    controls: dict[str, float]

    @property
    def met(self) -> bool:
        """Whether the goal is met."""
        sense, number = self.goal.split()
        return self.found <= float(number) if sense == "<=" else self.found >= float(number)

    def __str__(self) -> str:
        """Return the line."""
        wrong = ", ".join(f"{name} {value:.3g}" for name, value in self.controls.items())
        met = "yes" if self.met else "NO"
        return f"{self.what:<42}{self.goal:>8}{self.found:>9.3f} {met:<4} {wrong}"


# ------------------------------------------ Renders ----------------------------------------------


def previewed(scene: tactilux.Scene) -> tuple[Array, Array]:
    """Return what lamps that do not turn send to the camera, by the preview.

    From facets ``(lamp, site, facet)`` and untouched sites ``(lamp, site)``.
    """
    with tactilux.Preview(scene) as preview:
        facets, sites = preview.transport(*_straight(scene))
    return facets[:, 0, 0], sites[:, 0, 0]


def rendered(scene: tactilux.Scene, samples: int, seed: int) -> tuple[Array, Array]:
    """Return the same by the reference, with ``samples`` per cell."""
    found = tactilux.render_transport(scene, *_straight(scene), samples=samples, seeds=(seed,))
    return found.T[:, 0, 0], found.background[:, 0, 0]


def _straight(scene: tactilux.Scene) -> tuple[Array, Array]:
    return np.full((scene.lamp_count, 1), np.pi / 2), np.zeros(1)


def by_color(scene: tactilux.Scene, values: Array) -> Array:
    """Return the sums over the lamps of each of `COLORS`, as the last axis."""
    colors = np.array(scene.baseline_colors())
    return np.stack([values[colors == color].sum(axis=0) for color in COLORS], axis=-1)


def touched(scene: tactilux.Scene, sites: dict[str, float], **indenter: float) -> tactilux.Scene:
    """Return the scene with other keys in ``[sites]`` and ``[indenter]``."""
    parts = {"sites": unchecked(scene.sites, sites)}
    return unchecked(scene, parts | {"indenter": unchecked(scene.indenter, indenter)})


def places(scene: tactilux.Scene) -> tuple[Array, Array]:
    """Return x and y (mm) of the sites, row by row."""
    s = scene.sites
    x = s.centre_x + (np.arange(s.columns) - (s.columns - 1) / 2) * s.spacing
    y = s.centre_y + (np.arange(s.rows) - (s.rows - 1) / 2) * s.spacing
    return np.tile(x, s.rows), np.repeat(y, s.columns)


def between(scene: tactilux.Scene, values: Array, x: Array, y: Array) -> Array:
    """Return ``values (site, ...)`` at other places: a quartic in x and y of their logarithms."""
    at_x, at_y = places(scene)

    def powers(x: Array, y: Array) -> Array:
        u, v = ((a - b.mean()) / np.ptp(b) for a, b in ((x, at_x), (y, at_y)))
        return np.stack([u**i * v**j for i in range(5) for j in range(5 - i)], axis=-1)

    fitted = np.linalg.lstsq(powers(at_x, at_y), np.log(values), rcond=None)[0]
    return np.asarray(np.exp(powers(x, y) @ fitted))


def linear(path: Path, encoded: bool) -> Array:
    """Return a picture's linear values, ``(row, column, channel)``; 8 bits are ``encoded`` sRGB."""
    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    # On one core Mitsuba (3.9) has one thread, and waits for a second one to read an EXR.
    dr.set_thread_count(max(2, dr.thread_count()))
    picture = mi.Bitmap(str(path))
    picture.set_srgb_gamma(encoded)
    wide = picture.convert(component_format=mi.Struct.Type.Float32, srgb_gamma=False)
    return np.atleast_3d(np.array(wide, dtype=float))


def in_blocks(picture: Array) -> Array:
    """Return the means of blocks of a picture ``(row, column, ...)``; rests are cut off."""
    rows, columns = (size // BLOCK for size in picture.shape[:2])
    whole = picture[: rows * BLOCK, : columns * BLOCK]
    parts = whole.reshape(rows, BLOCK, columns, BLOCK, *picture.shape[2:])
    return np.asarray(parts.mean(axis=(1, 3)))


def off(render: Array, photograph: Array) -> float:
    """Return the median of ``|render / photograph - 1|``, one scale for each column of both."""
    ratio = render / photograph
    return float(np.median(np.abs(ratio / np.median(ratio, axis=0) - 1)))
