"""Whether a model has shown that it can rank designs, and what more samples would bring.

Held-out designs are ranked by the model and by the reference that it was fitted to; Kendall's tau
says how well both agree. A model of a preview that was held against renders of other sensors has at
least the tau that was found there. Where the reference is noisy no model can agree with it, and
none can learn from it: then more samples are needed. For normally distributed scores tau is
``(2 / pi) asin(r)`` with their correlation r (Greiner 1909), and noise of the variance q relative
to that of the true scores leaves ``r = 1 / sqrt(1 + q)`` with a perfect model; q falls as one over
the number of samples, or more slowly where few light paths carry most of the light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from render.levels import level_name
from surrogate.runtime.metadata import NOISE, ModelMetadata

RELIABLE_TAU = 0.85
"""What verification asks of a ranking as well, before it believes the surrogate."""
AIM = 0.9
"""Tau that a perfect model should reach against the reference of a new training."""
MANY_UNCONVERGED = 0.1
"""Share of cells from which it is a reason that they have not converged."""
MOST = 100.0
"""More times the samples than this cannot be told from a short render."""


@dataclass(frozen=True)
class RankingTest:
    """What the held-out designs say of a model's rankings.

    Arguments:
        tau: of the model against its reference.
        factor: times the samples that would let a perfect model reach AIM; at most MOST.
        samples: per cell that the model was trained with, where it was rendered for.
        unrendered: level and effort of a model without renders; empty for a trained one.
        unconverged: share of the reference's cells that had not converged.
    """

    tau: float
    factor: float
    samples: int | None
    unconverged: float = 0.0
    unrendered: str = ""

    @classmethod
    def of(cls, metadata: ModelMetadata) -> RankingTest:
        """Return what ``metadata`` holds of it."""
        held = {str(row["name"]): float(row["kendall_tau"]) for row in metadata.held_out}
        own, name = metadata.own_errors, level_name(metadata.level, metadata.effort)
        samples = metadata.renderer.get("samples_per_cell")
        found = 0.0 if own is None else float(own["kendall_tau"])
        return cls(
            tau=max(found, float(metadata.preview.get("ranks", 0.0))),
            factor=_factor(held.get(NOISE, 1.0)),
            samples=int(samples) if samples is not None else None,
            unconverged=int(metadata.residual.get("unreliable_cells", 0))
            / int(metadata.residual.get("cells", 1)),
            unrendered="" if metadata.rendered else name,
        )

    @property
    def reliable(self) -> bool:
        """Whether the model has shown that it ranks designs."""
        return self.tau >= RELIABLE_TAU

    def advice(self) -> str:
        """Return what more effort would bring, as a sentence; empty for a reliable model."""
        if self.reliable:
            return ""
        if self.unrendered:
            return (
                f"The {self.unrendered} ranks designs of such sensors with a Kendall's tau of "
                f"{self.tau:.2f}, needed: {RELIABLE_TAU:g}: train a model (tactilux train) or let "
                "renders decide (tactilux optimize)."
            )
        said = (
            f"This model has not shown that it can rank designs: on held-out ones Kendall's tau is "
            f"{self.tau:.2f}, needed: {RELIABLE_TAU:g}. "
        )
        many, factor = self.unconverged > MANY_UNCONVERGED, self.factor
        if factor <= 1.0 and not many:
            return said + (
                "The renders are good enough, so more samples will not help: the preview is too "
                "far from them in this scene; let renders decide (tactilux optimize)."
            )
        if many:
            said += f"Few light paths carry {self.unconverged:.0%} of the cells that it learned. "
            # The noise of the held-out designs does not know what no path has found.
            factor = max(factor, 2.0)
        times = _rounded(factor)
        said += f"Its renders are too noisy: train with at least {times} times the samples"
        if self.samples is None:
            return said + "."
        return f"{said} (--samples {_rounded(factor * self.samples)})."


def _rounded(value: float) -> str:
    """Return ``value`` with two digits.

    >>> _rounded(12345.6), _rounded(1.234)
    ('12000', '1.2')
    """
    return f"{float(f'{value:.2g}'):.10g}"


def _factor(noise_tau: float) -> float:
    """Return how many times the samples AIM takes; ``noise_tau`` of the reference and a copy.

    The copy has the noise twice: ``r^2 = (1 + q) / (1 + 2 q)``.
    """
    square = math.sin(0.5 * math.pi * max(noise_tau, 0.0)) ** 2
    aimed = 1.0 / math.sin(0.5 * math.pi * AIM) ** 2 - 1.0
    if square <= 0.5:
        return MOST
    return min((1.0 - square) / (2.0 * square - 1.0) / aimed, MOST)
