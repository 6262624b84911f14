"""Scores of rendered designs: freed of the bias of render noise, with error bars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optimize.design.design import Array
from optimize.scoring.jackknife import JackknifeEstimate, jackknife
from optimize.scoring.score_scale import PARTS, Scale
from render.errors import RenderError
from render.metric import clipped_fraction


@dataclass(frozen=True, eq=False)
class Measured:
    """One design at level 2: jackknife estimates by part of the score, and clipped facets."""

    parts: dict[str, JackknifeEstimate]
    clipped: float

    @property
    def score(self) -> JackknifeEstimate:
        """S of eq. (4.7)."""
        return self.parts["score"]


def measure(scale: Scale, replicates: Array, power: Array) -> Measured:
    """Jackknife every part of the score of ``replicates`` ``(R, F, B, S, K)``."""
    found = {}
    for index, name in enumerate(PARTS):

        def part(transport: Array, index: int = index) -> float:
            return float(scale.parts(transport, power)[index])

        found[name] = jackknife(part, replicates)
    counts = scale.counts(replicates.mean(axis=0), power)
    return Measured(found, float(clipped_fraction(counts, scale.conventions)))


def difference(
    scale: Scale, first: Array, first_power: Array, second: Array, second_power: Array
) -> JackknifeEstimate:
    """Return S of the second design minus S of the first.

    Both have replicates ``(R, F, B, S, K)`` that were made together, so that noise which they
    share cancels.
    """

    def gain(transport: Array) -> float:
        low = scale.parts(transport[0], first_power)[0]
        return float(scale.parts(transport[1], second_power)[0] - low)

    return jackknife(gain, np.stack([first, second], axis=1))


def check_seen(replicates: Array) -> None:
    """Refuse cells that are not numbers, ``(..., F, B, S, K)``.

    Raises:
        RenderError: the camera cannot see some facet, so the score is not defined.
    """
    finite = np.isfinite(replicates).all(axis=tuple(range(replicates.ndim - 3)))
    hidden = np.argwhere(~finite)
    if len(hidden):
        bend, site, facet = (int(i) for i in hidden[0])
        raise RenderError(
            f"the camera cannot see {len(hidden)} facets, the first is facet {facet} of site "
            f"{site} at bend {bend}, so there is no score: move the sites or the camera",
            field="sites",
        )
