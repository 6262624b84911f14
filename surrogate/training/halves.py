"""Whether renders bear a residual out, told by two halves of them that share no light path.

Cells of one render share light paths, so that a residual which follows their noise also foretells
cells that it has not seen: held-out cells cannot tell noise from light there. So a residual is
fitted to one half of the paths and held against the other. It takes the squared error of a half
from ``sum w rho^2`` to ``sum w (rho - e)^2``, with rho the half's relative deviation from the
preview and ``e = exp(r) - 1``. The gain, ``sum w e (2 rho - e)``, is linear in that half, so it is
free of bias. Cells weigh by the inverse variance of rho and by the square of the light that they
add to their facet, since colors are sums of light: what is gained on dim lamps, which lie far off
the preview, is lost on the bright ones that a design is seen by. Every lamp at every bend is one
observation of the gain; where their mean is not above 0 by Student's t, the renders bear nothing
out, and the preview stays as it is. Of several residuals that were tried the best gains by chance
too, which the confidence allows for (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from render.arrays import Array
from surrogate.training.dataset import RegressionData

SUPPORT = 0.95
"""Confidence at which a residual must gain, one-sided."""


def halves(rows: RegressionData) -> tuple[RegressionData, RegressionData]:
    """Return the rows of both halves of the light paths; ``rows`` must know their difference."""
    assert rows.half_difference is not None
    off = rows.half_difference
    return replace(rows, ratio=rows.ratio + off), replace(rows, ratio=rows.ratio - off)


def mean_gains(rows: RegressionData, fitted: Callable[[RegressionData, int], Array]) -> Array:
    """Return the gain ``(lamp * bend,)`` of what ``fitted`` returns for the rows of half 0 and 1.

    That is log T over the preview, ``(direction, fiber, bend, site, normal)``. The gain is per unit
    of weight, the mean of both halves held against each other.
    """
    both = halves(rows)
    gains = [_gains(both[1 - number], fitted(both[number], number)) for number in (0, 1)]
    return np.asarray(np.mean(gains, axis=0))


def borne_out(gains: Array, copies: int = 1, tried: int = 1) -> bool:
    """Return whether the mean of ``gains`` is above 0 by more than their scatter explains.

    ``copies`` of a lamp (`surrogate.model.lamp_copies`) share their paths and are one observation.
    The gains are the best of ``tried``.
    """
    gains = gains.reshape(copies, -1).mean(axis=0)
    if len(gains) < 2:
        return bool(gains.mean() > 0.0)
    error = gains.std(ddof=1) / np.sqrt(len(gains))
    support = 1.0 - (1.0 - SUPPORT) / tried
    return bool(gains.mean() > stdtrit(len(gains) - 1, support) * error)


def _gains(held: RegressionData, residual: Array) -> Array:
    shape = residual.shape
    weight, ratio = (values.double().numpy().reshape(shape) for values in (held.weight, held.ratio))
    light = np.exp(held.log_preview)
    weight = weight * (light / light.mean(axis=(0, 1))) ** 2
    moved = np.expm1(residual)
    gain = weight * moved * (2.0 * (ratio - 1.0) - moved)
    observations = shape[1] * shape[2]
    return np.asarray(gain.sum(axis=(0, 3, 4)).ravel() * observations / weight.sum())
