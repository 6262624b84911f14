"""What a builder can and cannot make: limits of designs, an optional section of the scene file.

They say which designs may be chosen, not what light does, so they have no part in the scene's hash.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated

from pydantic import AliasChoices, Field

from render.refused_values import did_you_mean
from render.scene.colors import OFF, RGB, ColorName, Palette
from render.scene.quantities import Count, Part, Quantity, since_schema_2

Angle = Annotated[float, Quantity("deg", 0.0, 180.0)]
Step = Annotated[float, Quantity("deg", 0.1, 90.0)]
PowerLimit = Annotated[float, Quantity("", 0.01, 1.0)]
Index = Annotated[int, Count(0, 191)]
LedCount = Annotated[int, Count(0, 192)]
Thickness = Annotated[float, Quantity("mm", 0.1, 50.0)]
STEP_TOLERANCE = 1e-9
HOLDER_THICKNESS = 3.0
"""mm, where a scene says nothing: four fiber diameters keep a direction to about 2 deg."""


class FixedFiber(Part):
    """A fiber that is already mounted: its color, its direction, or both."""

    fiber: Index
    color: Annotated[
        str | None,
        Field(validation_alias=AliasChoices("color", "colour")),  # as earlier scene files say
    ] = None
    angle: Angle | None = None


class ForbiddenDirections(Part):
    """Directions between ``low`` and ``high`` that cannot be mounted; inner ends are allowed.

    ``fibers`` are those that it holds for; none named means all.
    """

    low: Angle
    high: Angle
    fibers: Annotated[tuple[Index, ...], Field(strict=False)] = ()

    def holds_for(self, fiber: int) -> bool:
        """Return whether the limit concerns ``fiber``."""
        return not self.fibers or fiber in self.fibers


class ColorLimits(Part):
    """How many fibers may have a color, and the power of its LEDs (1 is full)."""

    max: LedCount | None = None
    power: PowerLimit = 1.0


class Constraints(Part):
    """Limits of designs; everything that is not named is free.

    ``colors`` has the limits of each color by name; ``max_*`` and ``power_*`` say the same of the
    colors that a scene has by default. ``off`` lets searches leave fibers dark. ``angle_step`` is
    the smallest step of directions from 0, ``continuous_power`` lets every fiber have a power of
    its own up to the limit. ``holder_thickness`` is that of the wall around the pad that holds the
    fibers, which must not meet in it.
    """

    max_red: LedCount | None = None
    max_green: LedCount | None = None
    max_blue: LedCount | None = None
    power_red: PowerLimit = 1.0
    power_green: PowerLimit = 1.0
    power_blue: PowerLimit = 1.0
    colors: dict[ColorName, ColorLimits] | None = since_schema_2()
    off: bool | None = since_schema_2()
    angle_step: Step | None = None
    continuous_power: bool = False
    holder_thickness: Thickness = HOLDER_THICKNESS
    fixed: Annotated[tuple[FixedFiber, ...], Field(strict=False)] = ()
    forbidden: Annotated[tuple[ForbiddenDirections, ...], Field(strict=False)] = ()

    def __hash__(self) -> int:
        """Return that of what equal constraints have: ``colors`` is a mapping, in any order."""
        others = (getattr(self, name) for name in type(self).model_fields if name != "colors")
        return hash((frozenset((self.colors or {}).items()), *others))

    def of_color(self, name: str) -> ColorLimits:
        """Return the limits of a color."""
        if self.colors and name in self.colors:
            return self.colors[name]
        if name not in RGB.names:
            return ColorLimits()
        most, power = getattr(self, f"max_{name}"), getattr(self, f"power_{name}")
        return ColorLimits.model_construct(max=most, power=power)

    def max_counts(self, palette: Palette, fibers: int) -> tuple[int, ...]:
        """Return the largest number of fibers of each color, of ``fibers`` in all."""
        limits = (self.of_color(name).max for name in palette.names)
        return tuple(fibers if limit is None else limit for limit in limits)

    def intervals(self, fiber: int) -> list[tuple[float, float]]:
        """Return the directions (rad) that ``fiber`` may have, closed intervals, ascending."""
        for entry in self.fixed:
            if entry.fiber == fiber and entry.angle is not None:
                return [(entry.angle, entry.angle)]
        allowed = [(0.0, math.pi)]
        for gap in self.forbidden:
            if gap.holds_for(fiber):
                parts = [((low, min(high, gap.low)), (max(low, gap.high), high))
                         for low, high in allowed]  # fmt: skip
                allowed = [part for pair in parts for part in pair if part[0] < part[1]]
        return allowed

    def grid(self, fiber: int) -> list[float] | None:
        """Return the directions (rad) on the steps that ``fiber`` may have; None: any between."""
        if self.angle_step is None or any(
            entry.fiber == fiber and entry.angle is not None for entry in self.fixed
        ):
            return None
        steps = [
            i * self.angle_step for i in range(int(math.pi / self.angle_step + STEP_TOLERANCE) + 1)
        ]
        return [
            min(step, math.pi)
            for step in steps
            if any(
                a - STEP_TOLERANCE <= step <= b + STEP_TOLERANCE for a, b in self.intervals(fiber)
            )
        ]

    def problems(self, palette: Palette, fibers: int, most_lit: int | None = None) -> Iterator[str]:
        """Yield what cannot be fulfilled with ``fibers`` fibers, one sentence each.

        At most ``most_lit`` may be lit; where that is fewer than there are, others are off.
        """
        yield from self._unknown_colors(palette)
        named = [entry.fiber for entry in self.fixed]
        named += [fiber for gap in self.forbidden for fiber in gap.fibers]
        for fiber in sorted({fiber for fiber in named if fiber >= fibers}):
            yield f"constraints name fiber {fiber}, allowed: 0 to {fibers - 1}"
        twice = {entry.fiber for entry in self.fixed if named.count(entry.fiber) > 1}
        for fiber in sorted(twice & {entry.fiber for entry in self.fixed}):
            if sum(entry.fiber == fiber for entry in self.fixed) > 1:
                yield f"constraints.fixed names fiber {fiber} twice, allowed: once"
        for gap in self.forbidden:
            if gap.low >= gap.high:
                yield (
                    f"constraints.forbidden: low = {math.degrees(gap.low):g} deg and high = "
                    f"{math.degrees(gap.high):g} deg, allowed: low below high"
                )
        limits = dict(zip(palette.names, self.max_counts(palette, fibers), strict=True))
        dark = self.off or (most_lit is not None and most_lit < fibers)
        if sum(limits.values()) < fibers and not dark:
            *first, last = (f"{limit} {color}" for color, limit in limits.items())
            every = f"{', '.join(first)} and {last}" if first else last
            yield (
                f"constraints: at most {every} LEDs for {fibers} fibers cannot be fulfilled, "
                f"allowed: at least {fibers} together"
            )
        for color, limit in limits.items():
            fixed = sum(entry.color == color for entry in self.fixed)
            if fixed > limit:
                yield (
                    f"constraints fix {fixed} {color} fibers, allowed: at most "
                    f"max_{color} = {limit}"
                )
        for fiber in range(fibers):
            if not self.intervals(fiber) or self.grid(fiber) == []:
                yield f"constraints leave no direction for fiber {fiber}: forbid less"
                return

    def _unknown_colors(self, palette: Palette) -> Iterator[str]:
        allowed = f"allowed: {', '.join(palette.names)}"
        for name in self.colors or {}:
            if name not in palette.names:
                meant = did_you_mean(name, palette.names)
                yield f"constraints.colors names {name}, {allowed}{meant}"
        for name in RGB.names:
            limited = [key for key in (f"max_{name}", f"power_{name}")
                       if getattr(self, key) != type(self).model_fields[key].default]  # fmt: skip
            if limited and name not in palette.names:
                yield f"constraints.{limited[0]}: the scene has no color {name}, {allowed}"
            elif limited and self.colors and name in self.colors:
                yield f"constraints.{limited[0]} and constraints.colors.{name}: say it once"
        for entry in self.fixed:
            if entry.color not in (None, OFF, *palette.names):
                yield f"constraints.fixed: color = {entry.color}, {allowed}, {OFF}"

    def sentences(self, palette: Palette) -> Iterator[str]:
        """Yield the limits in words."""
        for color in palette.names:
            limits = self.of_color(color)
            if limits.max is not None:
                yield f"at most {limits.max} {color} fibers"
            if limits.power < 1.0:
                yield f"{color} LEDs at {limits.power:g} of full power at most"
        if self.off:
            yield "fibers may be off"
        if self.angle_step is not None:
            yield f"directions in steps of {math.degrees(self.angle_step):g} deg"
        if self.continuous_power:
            yield "every fiber has a power of its own"
        for entry in self.fixed:
            angle = "" if entry.angle is None else f"{math.degrees(entry.angle):g} deg"
            yield f"fiber {entry.fiber} is {' '.join(filter(None, [entry.color, angle]))}"
        for gap in self.forbidden:
            who = ", ".join(map(str, gap.fibers)) if gap.fibers else "all"
            yield (
                f"no direction between {math.degrees(gap.low):g} and {math.degrees(gap.high):g} "
                f"deg (fibers: {who})"
            )
