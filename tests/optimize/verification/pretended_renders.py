"""Renders of designs that are the surrogate's table times a bias and noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from optimize.design import Design
from optimize.verification.design_renders import DesignRenders, RenderDesigns
from render.chebyshev import interpolation_weights
from render.transport import TransportTable

REPLICATES = 8
BASE = 0.5
"""A bias of the pretended renders against the surrogate: darker where fibers turn to the base."""


def biased(phi: np.ndarray, strength: float) -> np.ndarray:
    return np.exp(strength * np.cos(phi))


def pretended(table: TransportTable, noise: float, strength: float = BASE) -> RenderDesigns:
    """Return what renders from the table times a bias, with noise that designs share in part."""

    def render(
        designs: Sequence[Design], *, samples: int, seeds: Sequence[int], title: str
    ) -> DesignRenders:
        rng = np.random.default_rng(list(seeds))
        shape = (REPLICATES * len(seeds), *table.T.shape[:1], *table.T.shape[2:])
        common = noise * rng.standard_normal(shape)
        facets, pads = [], []
        for design in designs:
            weights = interpolation_weights(table.phi, design.phi)
            factor = biased(design.phi, strength)[:, None, None]
            own = 0.5 * noise * rng.standard_normal(shape)
            truth = table.at(design.phi) * factor[..., None]
            facets.append(truth * (1.0 + common + own))
            pad = np.einsum("fj,fjbs->fbs", weights, table.background) * factor
            pads.append(pad * (1.0 + common[..., 0]))
        return DesignRenders(
            tuple(designs), np.stack(facets, axis=1), np.stack(pads, axis=1), float(samples)
        )

    return render
