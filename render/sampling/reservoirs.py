"""Drawing one of several items in proportion to weights that come one after the other.

Reservoirs of size 1 (Chao 1982). The drawn item stands for all of them with the contribution weight
W, the sum of all weights over its own: resampled importance sampling (Talbot et al. 2005), as in
ReSTIR (Bitterli et al. 2020, "Spatiotemporal reservoir resampling").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi


@dataclass
class Reservoir:
    """The ``item`` drawn so far (a Dr.Jit PyTree), its ``weight``, and the ``total`` of all."""

    item: Any
    weight: mi.Float
    total: mi.Float

    @staticmethod
    def holding(item: Any) -> Reservoir:
        """Return one that has drawn nothing yet: ``item`` is of weight 0."""
        return Reservoir(item, mi.Float(0.0), mi.Float(0.0))

    def update(self, item: Any, weight: mi.Float, number: mi.Float) -> Reservoir:
        """Return this, or ``item`` with probability by its ``weight``; ``number`` is uniform."""
        total = self.total + weight
        replaces = (weight > 0) & (number * total < weight)
        return Reservoir(
            dr.select(replaces, item, self.item), dr.select(replaces, weight, self.weight), total
        )

    def contribution_weight(
        self, represented: mi.Float | float = 1.0, draws: mi.Float | float = 1.0
    ) -> mi.Float:
        """Return W, how many items the drawn one stands for; 0 where there is none.

        By itself it stands for ``represented`` ones; ``draws`` reservoirs of the same items share.
        """
        return dr.select(self.weight > 0, represented * self.total / (draws * self.weight), 0.0)

    def probability(self) -> mi.Float:
        """Return 1 / W, the share of the drawn item in the total; 0 where there is none."""
        return dr.select(self.weight > 0, self.weight / self.total, 0.0)


@dataclass
class OneNumberReservoir(Reservoir):
    """A reservoir that draws with one uniform ``number``.

    A comparison uses up no more of it than it decides, so what is left is uniform again.
    """

    number: mi.Float

    @staticmethod
    def drawing(item: Any, number: mi.Float) -> OneNumberReservoir:
        """Return one that has drawn nothing yet: ``item`` is of weight 0."""
        return OneNumberReservoir(item, mi.Float(0.0), mi.Float(0.0), mi.Float(number))

    def offered(
        self, item: Any, weight: mi.Float, share: mi.Float | None = None
    ) -> OneNumberReservoir:
        """Return this, or ``item`` with probability by its ``share`` of the total.

        That is its ``weight`` unless the item stands for other than one by itself.
        """
        share = weight if share is None else share
        total = self.total + share
        probability = dr.select(weight > 0, share / total, 0.0)
        replaces = self.number < probability
        rest = dr.select(replaces, self.number, self.number - probability)
        return OneNumberReservoir(
            dr.select(replaces, item, self.item),
            dr.select(replaces, weight, self.weight),
            total,
            rest / dr.select(replaces, probability, 1.0 - probability),
        )
