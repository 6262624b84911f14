"""A lighting design: where each fiber points and which LED drives it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.errors import DesignError
from render.geometry import fiber_edges
from render.scene import COLORS, Scene

Array = NDArray[np.float64]
Colors = NDArray[np.int64]

# Without an LED a fiber is dark; it has no color index.
OFF = -1


@dataclass(frozen=True, eq=False)
class Design:
    """Directions ``phi`` ``(F,)`` in [0, pi] rad and LED powers ``power`` ``(F, 3)`` in [0, 1]."""

    phi: Array
    power: Array

    def __post_init__(self) -> None:
        """Refuse wrong shapes, values out of range and NaN."""
        if self.phi.ndim != 1 or not len(self.phi):
            raise DesignError(f"phi has shape {self.phi.shape}, allowed: (fibers,)", field="phi")
        if self.power.shape != (len(self.phi), 3):
            raise DesignError(
                f"power has shape {self.power.shape}, allowed: {(len(self.phi), 3)}", field="power"
            )
        for name, values, high in (("phi", self.phi, math.pi), ("power", self.power, 1.0)):
            bad = ~((values >= 0.0) & (values <= high))
            if bad.any():
                place = tuple(int(i) for i in np.argwhere(bad)[0])
                limit = "0 to pi rad" if name == "phi" else "0 to 1"
                raise DesignError(
                    f"{name}{list(place)} = {values[place]:g}, allowed: {limit}",
                    field=name,
                    value=float(values[place]),
                    allowed=limit,
                )

    @classmethod
    def of_colors(cls, phi: Array, colors: Sequence[int] | Colors) -> Design:
        """Return the design with one LED at full power per fiber; ``colors`` 0/1/2 = R/G/B."""
        chosen = np.asarray(colors, dtype=np.int64)
        if chosen.ndim != 1 or ((chosen < 0) | (chosen > 2)).any():
            raise DesignError(
                f"colors = {chosen.tolist()}, allowed: one of 0, 1, 2 (red, green, blue) per fiber",
                field="colors",
            )
        return cls(np.asarray(phi, dtype=np.float64), np.eye(3)[chosen])

    @property
    def colors(self) -> Colors:
        """The strongest channel of each fiber, ``(F,)``: 0/1/2 = R/G/B, -1 for a dark fiber."""
        strongest = np.argmax(self.power, axis=1)
        return np.where(self.power.max(axis=1) > 0.0, strongest, OFF)

    @property
    def color_names(self) -> list[str]:
        """The color of each fiber as ``red``, ``green``, ``blue`` or ``off``."""
        return [color_name(index) for index in self.colors]

    @property
    def monochrome(self) -> bool:
        """Whether one color lights everything: then hue says nothing, and lam is too large."""
        return len(set(self.colors.tolist())) == 1


@dataclass(frozen=True, eq=False)
class ScoredDesign:
    """A design with a score in counts: S of eq. (4.7), or what a search maximized instead."""

    design: Design
    score: float


def color_name(index: int) -> str:
    """Return ``red``, ``green``, ``blue`` or, for -1, ``off``."""
    return "off" if index == OFF else COLORS[index]


def baseline_design(scene: Scene) -> Design:
    """Return the design to beat: one color per edge, every fiber normal to it (thesis 5.1)."""
    colors = [COLORS.index(getattr(scene.baseline, edge)) for edge in fiber_edges(scene)]
    return Design.of_colors(np.full(scene.fibers.count, math.pi / 2), colors)
