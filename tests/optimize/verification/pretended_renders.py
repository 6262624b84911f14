"""Renders of designs that are a table times a bias and noise of known size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from optimize.design import Design
from optimize.verification.design_renders import DesignRenders, RenderDesigns
from render.chebyshev import interpolation_weights
from render.reference import EVERYTHING, SampleAllocation
from render.transport import TransportTable

REPLICATES = 8
BASE = 0.5
"""A bias of the pretended renders against the surrogate: darker where fibers turn to the base."""
ROUND_NOISE = 0.8
"""Relative standard deviation of a cell of one replicate at 96 samples (finger20, measured)."""
SHARES = (0.27, 0.42, 0.31)
"""Of the variance: common to a site's facets and all designs, to all designs, of a cell alone.

Measured in two rounds of finger20 at 96 samples: correlation of opposite facets 0.27, of designs
that differ little 0.76 to 0.92, of any two 0.35; the skewness is 1.36, a gamma distribution's 1.6.
"""


def biased(phi: np.ndarray, strength: float) -> np.ndarray:
    return np.exp(strength * np.cos(phi))


def pretended(
    table: TransportTable, noise: float, strength: float = BASE, seconds: float = 0.0
) -> RenderDesigns:
    """Return what renders from the table times a bias, with noise that cells and designs share.

    A render takes ``seconds``, unless given one per sample and seed.
    """

    def render(
        designs: Sequence[Design],
        *,
        samples: int,
        seeds: Sequence[int],
        title: str,
        allocation: SampleAllocation = EVERYTHING,
    ) -> DesignRenders:
        rng = np.random.default_rng(list(seeds))
        shape = (REPLICATES * len(seeds), *table.T.shape[:1], *table.T.shape[2:])

        def factor(share: float, *axes: int) -> np.ndarray:
            variance = max(share * noise**2, 1e-12)
            return np.asarray(rng.gamma(1.0 / variance, variance, axes))

        common = factor(SHARES[0], *shape[:-1], 1) * factor(SHARES[1], *shape)
        facets, pads = [], []
        for design in designs:
            weights = interpolation_weights(table.phi, design.phi)
            bias = biased(design.phi, strength)[:, None, None]
            truth = table.at(design.phi) * bias[..., None]
            facets.append(truth * common * factor(SHARES[2], *shape))
            pad = np.einsum("fj,fjbs->fbs", weights, table.background) * bias
            pads.append(pad * common[..., 0])
        pressed = np.stack(facets, axis=1)
        return DesignRenders(
            tuple(designs),
            pressed,
            np.stack(pads, axis=1),
            pressed.std(axis=0, ddof=1) / np.sqrt(len(pressed)),
            seconds or float(samples * len(seeds)),
        )

    return render
