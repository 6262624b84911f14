"""How much of what a render's facets differ by is noise.

S (thesis eq. 4.7) is made of what facets differ by: in brightness, and in hue from one neighbor to
the next. Noise makes them differ too. The more of it there is, the less halves of the replicates
score worse than their mean (``optimize.scoring.jackknife``), so that the bias of S is not found and
its intervals hold too little (``tests/validation/test_score_error_bars.py``).
"""

from __future__ import annotations

import math

import numpy as np

from optimize.design import Array, ScoreSettings
from optimize.scoring.jackknife import jackknife_se
from render.metric import facet_differences
from render.reference import more_effort

UNCONVERGED_SHARE = 0.4
"""Share of noise from which the error bar of a score is not known."""


def noise_share(settings: ScoreSettings, replicates: Array, power: Array) -> float:
    """Return the share of noise in what facets differ by, from 0 to about 1.

    It is the root of the noise's part of their mean squares over all states and sites: of ``|c_i|``
    less its mean over a site's facets, and of the steps ``c_hat_i+1 - c_hat_i``. Both terms of M
    weigh alike (``lambda``), and so do they here; one in which no facets differ (hues of one
    channel) is left out. The noise is that of the mean of ``replicates`` ``(R, F, B, S, K[, C])``,
    by leaving one out (Tukey 1958).
    """

    def differences(light: Array) -> Array:
        counts = settings.counts(light, power)
        brightness, steps = facet_differences(counts, settings.conventions)
        apart = brightness - brightness.mean(axis=-1, keepdims=True)
        return np.concatenate([apart.ravel(), steps.ravel()])

    cut = [math.prod(replicates.shape[2:5])]
    noise = np.split(jackknife_se(differences, replicates) ** 2, cut)
    whole = np.split(differences(replicates.mean(axis=0)) ** 2, cut)
    parts = [one.sum() / both.sum() for one, both in zip(noise, whole, strict=True) if both.any()]
    return math.sqrt(np.mean(parts)) if parts else 0.0


def noise_doubt(
    settings: ScoreSettings, replicates: Array, power: Array, samples: int | None = None
) -> str:
    """Say that noise hides what the score is made of; "" where it does not.

    ``samples`` are those per cell; without them it asks for multiples. What facets differ by
    without noise stays, and the variance of noise falls with the samples.
    """
    share = noise_share(settings, replicates, power)
    if share <= UNCONVERGED_SHARE:
        return ""
    times = (UNCONVERGED_SHARE**-2 - 1.0) / max(share**-2 - 1.0, 1e-3)
    return f"noise makes {share:.0%} of what its facets differ by; {more_effort(times, samples)}"
