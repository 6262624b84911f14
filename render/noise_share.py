"""How much of what a render's facets differ by is noise.

S (thesis eq. 4.7) is made of what facets differ by: in brightness, and in hue from one neighbor to
the next. Noise makes them differ too. The more of it there is, the less halves of the replicates
score worse than their mean (``optimize.scoring.jackknife``), so that the bias of S is not found and
its intervals hold too little (``tests/validation/test_score_error_bars.py``).
"""

from __future__ import annotations

import math

import numpy as np

from render.arrays import Array
from render.leave_one_out import jackknife_se
from render.metric import THESIS, MetricConfig, facet_differences, image_counts

UNCONVERGED_SHARE = 0.4
"""Share of noise from which the error bar of a score is not known."""


def noise_share(
    replicates: Array, power: Array, exposure: float, config: MetricConfig = THESIS
) -> float:
    """Return the share of noise in what facets differ by, from 0 to about 1.

    It is the root of the noise's part of their mean squares over all states and sites: of ``|c_i|``
    less its mean over a site's facets, and of the steps ``c_hat_i+1 - c_hat_i``. Both terms of M
    weigh alike (``lambda``), and so do they here; one in which no facets differ (hues of one
    channel) is left out. The noise is that of the mean of ``replicates``, by leaving one out.

    Arguments:
        replicates: transport ``(R, F, B, S, K[, C])``; two halves of a render will do.
        power: ``(F, C)``.
        exposure: counts per unit of radiance.
        config: conventions of the metric.
    """

    def differences(light: Array) -> Array:
        counts = np.asarray(image_counts(light, power, exposure, config))
        brightness, steps = facet_differences(counts, config)
        apart = brightness - brightness.mean(axis=-1, keepdims=True)
        return np.concatenate([apart.ravel(), steps.ravel()])

    cut = [math.prod(replicates.shape[2:5])]
    noise = np.split(jackknife_se(differences, replicates) ** 2, cut)
    whole = np.split(differences(replicates.mean(axis=0)) ** 2, cut)
    parts = [one.sum() / both.sum() for one, both in zip(noise, whole, strict=True) if both.any()]
    return math.sqrt(np.mean(parts)) if parts else 0.0


def converging_effort(share: float) -> float:
    """Return times how many samples leave UNCONVERGED_SHARE of a ``share`` of noise.

    What facets differ by without noise stays, and the variance of noise falls with the samples:
    ``s^2 / (1 - s^2)`` is as their inverse. A share of about 1 takes some thousand times at least.

    >>> f"{converging_effort(0.0):.0f}, {converging_effort(0.4):.3g}, {converging_effort(0.8):.3g}"
    '0, 1, 9.33'
    """
    square, allowed = share**2, UNCONVERGED_SHARE**2
    return square / max(1.0 - square, 1e-3) * (1.0 - allowed) / allowed
