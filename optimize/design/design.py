"""A lighting design: where each fiber points and which LED drives it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from render.arguments import as_kind, as_numbers, refuse
from render.errors import DesignError
from render.scene import RGB, Palette, Scene, as_scene

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
        as_kind(self.palette, Palette, "palette", "the palette of a scene", DesignError)
        object.__setattr__(self, "phi", as_numbers(self.phi, "phi", DesignError))
        object.__setattr__(self, "drive", as_numbers(self.drive, "drive", DesignError))
        if self.phi.ndim != 1 or not len(self.phi):
            raise DesignError(f"phi has shape {self.phi.shape}, allowed: (fibers,)", field="phi")
        expected = (len(self.phi), len(self.palette.names))
        if self.drive.shape != expected:
            raise DesignError(
                f"power has shape {self.drive.shape}, allowed: {expected}, as phi has "
                f"{len(self.phi)} fibers",
                field="power",
            )
        for name, values, high in (("phi", self.phi, math.pi), ("power", self.drive, 1.0)):
            bad = ~((values >= 0.0) & (values <= high))
            if bad.any():
                place = tuple(int(i) for i in np.argwhere(bad)[0])
                limit = "0 to pi rad" if name == "phi" else "0 to 1"
                raise DesignError(
                    f"{name}{list(place)} = {values[place]:g}, allowed: {limit}", field=name
                )

        shots = self.palette.in_shots(self.drive).max(axis=-1)
        if self.palette.shots > 1 and (shots > 1.0 + 1e-9).any():
            shot, fiber = (int(i) for i in np.argwhere(shots > 1.0 + 1e-9)[0])
            raise DesignError(
                f"power[{fiber}] adds up to {shots[shot, fiber]:g} in shot {shot + 1}, allowed: 0 "
                "to 1 of each LED",
                field="power",
            )

    @classmethod
    def of_colors(
        cls, phi: Array, colors: Sequence[int] | Colors, palette: Palette = RGB
    ) -> Design:
        """Return the design with one LED of ``palette`` at full power per fiber, none for -1."""
        as_kind(palette, Palette, "palette", "the palette of a scene", DesignError)
        phi, count = as_numbers(phi, "phi", DesignError), len(palette.names)
        allowed = (
            f"one of {', '.join(map(str, range(count)))} ({', '.join(palette.names)}) or {DARK} "
            "(off) per fiber"
        )
        try:
            numbers = as_numbers(colors, "colors", DesignError)
        except DesignError:
            refuse(colors, "colors", allowed, DesignError)
        if numbers.shape != phi.shape:
            raise DesignError(
                f"colors has shape {numbers.shape}, allowed: one for each of phi, {phi.shape}",
                field="colors",
            )
        known = (numbers == np.floor(numbers)) & (numbers >= DARK) & (numbers < count)
        if not known.all():
            refuse(np.asarray(colors).tolist(), "colors", allowed, DesignError)
        return cls(phi, one_led(numbers.astype(np.int64), count), palette)

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

    def __repr__(self) -> str:
        """Return in one line how many fibers have which color, and where they point."""
        names = self.color_names
        lit = ", ".join(f"{names.count(name)} {name}" for name in dict.fromkeys(names))
        low, high = np.degrees([self.phi.min(), self.phi.max()])
        return f"<Design of {len(names)} fibers: {lit}; phi {low:.4g} to {high:.4g} deg>"

    def _repr_html_(self) -> str:
        """Return the line and a table of the fibers."""
        from render.notebook import tabled

        rows = [
            (str(fiber), name, f"{np.degrees(phi):.4g}", ", ".join(f"{x:.3g}" for x in drive))
            for fiber, (name, phi, drive) in enumerate(
                zip(self.color_names, self.phi, self.drive, strict=True)
            )
        ]
        leds = ", ".join(self.palette.names)
        return tabled(repr(self), ("fiber", "color", "phi, deg", f"power of {leds}"), rows)

    def check_fits(self, scene: Scene, origin: str = "the design") -> None:
        """Refuse a design that is not one of ``scene``'s.

        Raises:
            DesignError: it has not the scene's number of fibers, or not its LEDs.
        """
        self.check_fiber_count(scene, origin)
        if self.palette != scene.palette:
            raise DesignError(
                f"{origin} has the LEDs {', '.join(self.palette.names)}, allowed: those of scene "
                f"{scene.name} ({', '.join(scene.palette.names)}); give palette=scene.palette",
                field="palette",
            )

    def check_fiber_count(self, scene: Scene, origin: str = "the design") -> None:
        """Refuse a design that has not ``scene``'s number of fibers, with a DesignError."""
        if len(self.phi) != scene.lamp_count:
            raise DesignError(
                f"{origin} has {len(self.phi)} fibers, allowed: {scene.lamp_count} as in scene "
                f"{scene.name}",
                field="fibers",
            )

    @property
    def monochrome(self) -> bool:
        """Whether one color of several hues lights everything: then lam is too large.

        A single lamp has no choice, and its hue no weight.
        """
        choice = not self.palette.one_shot.one_hue and len(self.phi) > 1
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


def baseline_design(scene: Scene | str | Path) -> Design:
    """Return the design to beat: one color per edge, every fiber normal to it (thesis 5.1).

    ``scene`` is the sensor, its name or its file.
    """
    scene = as_scene(scene)
    palette = scene.palette
    colors = [palette.index(color) for color in scene.baseline_colors()]
    return Design.of_colors(np.full(scene.lamp_count, math.pi / 2), colors, palette)
