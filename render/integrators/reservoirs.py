"""Drawing one of many light vertices for a camera vertex, in two steps.

Reservoirs of size one: a glimpse draws from a handful, a promise from what the glimpses drew. What
was drawn stands for all that were offered (resampled importance sampling, Talbot et al. 2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi


@dataclass
class Glimpsed:
    """One of several light vertices, drawn by glimpses: its place, its hope, and that of all.

    ``number`` is what is left of the uniform number that it is drawn with: a comparison uses up no
    more of it than it decides. A Dr.Jit PyTree.
    """

    place: Any
    hope: Any
    total: Any
    number: Any

    @staticmethod
    def none(number: Any) -> Glimpsed:
        """Return none yet."""
        return Glimpsed(mi.UInt32(0), mi.Float(0.0), mi.Float(0.0), mi.Float(number))

    def offered(self, place: Any, hope: Any, stands_for: Any = 1.0) -> Glimpsed:
        """Return this, or the vertex at ``place`` with probability by its ``hope``."""
        total = self.total + hope * stands_for
        share = dr.select(hope > 0, hope * stands_for / total, 0.0)
        chosen = self.number < share
        left = dr.select(chosen, self.number, self.number - share)
        return Glimpsed(
            dr.select(chosen, place, self.place),
            dr.select(chosen, hope, self.hope),
            total,
            left / dr.select(chosen, share, 1.0 - share),
        )

    def all(self) -> Any:
        """Return how many vertices the drawn one stands for; 0 where there is none."""
        return dr.select(self.hope > 0, self.total / self.hope, 0.0)


@dataclass
class Drawn:
    """The light vertex drawn for one camera vertex: its place, its promise, and that of all.

    By itself it stands for ``share`` vertices. Bridges have a mirror too, which was drawn with
    probability ``chance``. A Dr.Jit PyTree.
    """

    place: Any
    share: Any
    hope: Any
    total: Any
    mirror: Any
    chance: Any

    @staticmethod
    def none() -> Drawn:
        """Return none yet."""
        share, hope, total, chance = (mi.Float(0.0) for _ in range(4))
        return Drawn(mi.UInt32(0), share, hope, total, mi.UInt32(0), chance)

    def offered(
        self, place: Any, share: Any, hope: Any, number: Any, mirror: Any = 0, chance: Any = 0.0
    ) -> Drawn:
        """Return this, or the vertex at ``place`` with probability by its ``hope``."""
        total = self.total + hope
        chosen = (hope > 0) & (number * total < hope)
        return Drawn(
            dr.select(chosen, place, self.place),
            dr.select(chosen, share, self.share),
            dr.select(chosen, hope, self.hope),
            total,
            dr.select(chosen, mirror, self.mirror),
            dr.select(chosen, chance, self.chance),
        )

    def all(self) -> Any:
        """Return how many vertices the drawn one stands for; 0 where there is none."""
        there = self.hope > 0
        return dr.select(there, self.share * self.total / self.hope, 0.0)
