"""Directions of lamps that are mirror images: one of a pair is chosen, the other follows it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optimize.design.design import Array, Colors
from render.errors import DesignError
from render.geometry import flat_fiber_poses
from render.scene import Scene
from render.scene.places import SIGNS, Mirror

Intervals = list[tuple[float, float]]
"""Allowed directions, rad, closed and ascending."""


@dataclass(frozen=True, eq=False)
class TiedDirections:
    """Which lamp's direction each one follows.

    Arguments:
        leading: ``(F,)`` the lamp that is followed; a lamp that is alone follows itself.
        reflected: ``(F,)`` whether phi is pi minus that of the leading lamp, or else the same.
    """

    leading: Colors
    reflected: NDArray[np.bool_]

    @classmethod
    def none(cls, fibers: int) -> TiedDirections:
        """Return those of lamps that all turn by themselves."""
        return cls(np.arange(fibers), np.zeros(fibers, dtype=bool))

    @classmethod
    def of(cls, scene: Scene, pairs: Sequence[int | None], mirror: Mirror) -> TiedDirections:
        """Return those of a scene whose lamps have these images.

        A mirror turns a lamp the other way, unless its directions are counted the other way too.
        """
        along = flat_fiber_poses(scene).along
        leading = np.array([i if j is None else min(i, j) for i, j in enumerate(pairs)])
        same = (along * along[leading] * SIGNS[mirror]).sum(axis=1) > 0.0
        return cls(leading, ~same & (leading != np.arange(len(pairs))))

    @property
    def leads(self) -> NDArray[np.bool_]:
        """``(F,)`` lamps that follow none but themselves."""
        return np.asarray(self.leading == np.arange(len(self.leading)))

    def mirrored(self, phi: Array) -> Array:
        """Return directions ``(..., F)`` rad, each as its leading lamp has it in ``phi``."""
        lead = phi[..., self.leading]
        return np.where(self.reflected, math.pi - lead, lead)

    def unmirrored(self, slopes: Array) -> Array:
        """Return derivatives ``(F,)`` by directions of leading lamps, from those by each."""
        found = np.zeros_like(slopes)
        np.add.at(found, self.leading, np.where(self.reflected, -slopes, slopes))
        return found

    def with_images(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which lamps ``(..., F)`` are ``chosen``, or follow or lead one that is."""
        return np.asarray(chosen @ (self.leading[:, None] == self.leading))

    def allowed(self, intervals: Sequence[Intervals], step: float | None) -> list[Intervals]:
        """Return the directions that each lamp, and its image, may have on ``intervals``.

        Raises:
            DesignError: none is left, or images are not on a ``step`` (rad).
        """
        steps = math.pi / step if step else 0.0
        if step and self.reflected.any() and abs(steps - round(steps)) > 1e-9:
            raise DesignError(
                f"constraints.angle_step = {math.degrees(step):g} deg, but search.mirror turns "
                "images the other way, allowed: a step that divides 180 deg",
                field="constraints.angle_step",
            )
        found = list(intervals)
        for lamp in np.flatnonzero(~self.leads).tolist():
            lead = int(self.leading[lamp])
            own = self._seen(lamp, found[lamp])
            both = [(max(a, c), min(b, d)) for a, b in found[lead] for c, d in own]
            found[lead] = [(low, high) for low, high in both if low <= high]
            if not found[lead]:
                raise DesignError(
                    f"lamps {lead} and {lamp} are images of each other, but no direction of one "
                    "is allowed to the other: fix or forbid fewer directions",
                    field="search.mirror",
                )
            found[lamp] = self._seen(lamp, found[lead])
        return found

    def _seen(self, lamp: int, intervals: Intervals) -> Intervals:
        if not self.reflected[lamp]:
            return intervals
        return [(math.pi - high, math.pi - low) for low, high in reversed(intervals)]
