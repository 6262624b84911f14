"""The mean of a film, from a pilot and film positions that follow it."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from tests.render.integrators.test_bidirectional import lambert, plane

SAMPLES = 1 << 16


def test_the_guided_normalization_is_the_mean_of_the_picture_under_any_weights(
    mono: ModuleType,
) -> None:
    from render.integrators.film_sampler import FilmSampler
    from render.integrators.normalization import Normalization
    from render.integrators.subpaths import PathLimits

    scene = plane(mono)
    sampler = FilmSampler(scene, scene.sensors()[0], PathLimits(max_depth=2))
    normalization = Normalization(sampler, SAMPLES, 1024, 8, seed=3)
    assert (
        normalization.for_pilot + normalization.for_starts + normalization.for_estimate == SAMPLES
    )
    truth = lambert().ravel()
    pilot = normalization.pilot()[:, 0]
    assert pilot.mean() == pytest.approx(truth.mean(), rel=0.02)
    for weights in (np.ones(sampler.bins), 1 / pilot, np.arange(sampler.bins) % 8 + 0.1):
        means = normalization.means(weights[:, None] / sampler.bins)
        error = means.std(ddof=1) / np.sqrt(len(means))
        # Student's t with 7 degrees of freedom: 0.9999 quantile.
        assert abs(means.mean() - (weights * truth).mean()) < 8 * error
        assert error < 0.01 * means.mean()
