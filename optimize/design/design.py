"""A lighting design: where each fiber points and which LED drives it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from render.errors import DesignError
from render.scene import RGB, Palette, Scene

Array = NDArray[np.float64]
Colors = NDArray[np.int64]

DARK = -1
"""The color index of a fiber whose LEDs are off."""


@dataclass(frozen=True, eq=False)
class Design:
    """Directions ``phi`` ``(F,)`` in [0, pi] rad and LED powers ``drive`` ``(F, color)`` in [0, 1].

    ``palette`` says what the colors are and what the camera's channels see of them.
    """

    phi: Array
    drive: Array
    palette: Palette = RGB

    def __post_init__(self) -> None:
        """Refuse wrong shapes, values out of range and NaN."""
        if self.phi.ndim != 1 or not len(self.phi):
            raise DesignError(f"phi has shape {self.phi.shape}, allowed: (fibers,)", field="phi")
        expected = (len(self.phi), len(self.palette.names))
        if self.drive.shape != expected:
            raise DesignError(
                f"power has shape {self.drive.shape}, allowed: {expected}", field="power"
            )
        for name, values, high in (("phi", self.phi, math.pi), ("power", self.drive, 1.0)):
            bad = ~((values >= 0.0) & (values <= high))
            if bad.any():
                place = tuple(int(i) for i in np.argwhere(bad)[0])
                limit = "0 to pi rad" if name == "phi" else "0 to 1"
                raise DesignError(
                    f"{name}{list(place)} = {values[place]:g}, allowed: {limit}", field=name
                )

    @classmethod
    def of_colors(
        cls, phi: Array, colors: Sequence[int] | Colors, palette: Palette = RGB
    ) -> Design:
        """Return the design with one LED of ``palette`` at full power per fiber, none for -1."""
        chosen = np.asarray(colors, dtype=np.int64)
        count = len(palette.names)
        if chosen.ndim != 1 or ((chosen < DARK) | (chosen >= count)).any():
            raise DesignError(
                f"colors = {chosen.tolist()}, allowed: one of {', '.join(map(str, range(count)))} "
                f"({', '.join(palette.names)}) or {DARK} (off) per fiber",
                field="colors",
            )
        return cls(np.asarray(phi, dtype=np.float64), one_led(chosen, count), palette)

    @cached_property
    def power(self) -> Array:
        """What the fibers give to the camera's channels, ``(F, channel)``, as shares of T."""
        return np.asarray(self.drive @ self.palette.matrix)

    @property
    def colors(self) -> Colors:
        """The strongest LED of each fiber, ``(F,)``, an index of the palette; -1 if it is dark."""
        strongest = np.argmax(self.drive, axis=1)
        return np.where(self.drive.max(axis=1) > 0.0, strongest, DARK)

    @property
    def color_names(self) -> list[str]:
        """The color of each fiber by name, ``off`` without light."""
        return [self.palette.name(index) for index in self.colors]

    @property
    def monochrome(self) -> bool:
        """Whether one color of several hues lights everything: then lam is too large.

        A single lamp has no choice, and its hue no weight.
        """
        choice = not self.palette.one_hue and len(self.phi) > 1
        return choice and len(set(self.colors.tolist())) == 1


@dataclass(frozen=True, eq=False)
class ScoredDesign:
    """A design with a score in counts: S of eq. (4.7), or what a search maximized instead."""

    design: Design
    score: float


def one_led(colors: Colors, count: int) -> Array:
    """Return drives ``(..., F, count)``: the LED of every ``colors`` ``(..., F)``, none for -1."""
    # Minus one is the last row of a table, which is dark.
    return np.asarray(np.vstack([np.eye(count), np.zeros(count)])[colors])


def baseline_design(scene: Scene) -> Design:
    """Return the design to beat: one color per edge, every fiber normal to it (thesis 5.1)."""
    palette = scene.palette
    colors = [palette.index(color) for color in scene.baseline_colors()]
    return Design.of_colors(np.full(scene.lamp_count, math.pi / 2), colors, palette)
