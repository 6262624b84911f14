"""What a builder can and cannot make: limits of designs, an optional section of the scene file.

They say which designs may be chosen, not what light does, so they have no part in the scene's hash.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import AliasChoices, Field

from render.scene.quantities import Count, Part, Quantity

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
        Literal["red", "green", "blue"] | None,
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


class Constraints(Part):
    """Limits of designs; everything that is not named is free.

    ``max_*`` limit the number of fibers per color, ``power_*`` the power of an LED (1 is full),
    ``angle_step`` is the smallest step of directions from 0, ``continuous_power`` lets every fiber
    have a power of its own up to the limit. ``holder_thickness`` is that of the wall around the pad
    that holds the fibers, which must not meet in it.
    """

    max_red: LedCount | None = None
    max_green: LedCount | None = None
    max_blue: LedCount | None = None
    power_red: PowerLimit = 1.0
    power_green: PowerLimit = 1.0
    power_blue: PowerLimit = 1.0
    angle_step: Step | None = None
    continuous_power: bool = False
    holder_thickness: Thickness = HOLDER_THICKNESS
    fixed: Annotated[tuple[FixedFiber, ...], Field(strict=False)] = ()
    forbidden: Annotated[tuple[ForbiddenDirections, ...], Field(strict=False)] = ()

    def max_counts(self, fibers: int) -> tuple[int, int, int]:
        """Return the largest number of red, green and blue fibers, of ``fibers`` in all."""
        limits = (self.max_red, self.max_green, self.max_blue)
        red, green, blue = (fibers if limit is None else limit for limit in limits)
        return red, green, blue

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

    def problems(self, fibers: int) -> Iterator[str]:
        """Yield what cannot be fulfilled with ``fibers`` fibers, one sentence each."""
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
        limits = self.max_counts(fibers)
        if sum(limits) < fibers:
            yield (
                f"constraints: at most {limits[0]} red, {limits[1]} green and {limits[2]} blue "
                f"LEDs for {fibers} fibers cannot be fulfilled, allowed: at least {fibers} together"
            )
        for index, color in enumerate(("red", "green", "blue")):
            fixed = sum(entry.color == color for entry in self.fixed)
            if fixed > limits[index]:
                yield (
                    f"constraints fix {fixed} {color} fibers, allowed: at most "
                    f"max_{color} = {limits[index]}"
                )
        for fiber in range(fibers):
            if not self.intervals(fiber) or self.grid(fiber) == []:
                yield f"constraints leave no direction for fiber {fiber}: forbid less"
                return

    def sentences(self) -> Iterator[str]:
        """Yield the limits in words."""
        for color in ("red", "green", "blue"):
            limit, power = getattr(self, f"max_{color}"), getattr(self, f"power_{color}")
            if limit is not None:
                yield f"at most {limit} {color} fibers"
            if power < 1.0:
                yield f"{color} LEDs at {power:g} of full power at most"
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
