"""The luminance scale against ``luminance_samples``: thesis Fig. 3.3 on the slab with a disk light.

The scale fixes the mean intensity of a Metropolis picture; Mitsuba 0.6 needs 1e7 samples for a
standard deviation of 0.2 %. Here it comes from the plain samples of the run.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy import stats

from tests.long import LONG
from tests.validation.test_slab_reference import lamp, slab

SEEDS, GROUPS = 8, 32
SAMPLES = [65_536, 100_000, 1_000_000, 10_000_000] if LONG else [65_536]
LANES = 1 << 18
DEMANDED = 0.002 * np.sqrt(1e7)
"""Relative standard deviation times the root of ``luminance_samples``."""


@pytest.mark.parametrize("samples", SAMPLES)
def test_the_mean_intensity_scatters_less_than_0_2_percent_at_ten_million_samples(
    mono: ModuleType, tmp_path: Path, samples: int
) -> None:
    from render.integrators.film_sampler import FilmSampler
    from render.integrators.subpaths import PathLimits
    from render.integrators.vertex_cache import SHARED_PATHS
    from render.sampling.monte_carlo import monte_carlo_replicates

    scene = slab(mono, tmp_path, lamp(mono))
    sampler = FilmSampler(scene, scene.sensors()[0], PathLimits())
    passes = -(-samples // LANES)
    lanes = -(-samples // passes)
    sharing = sampler.sharing(lanes, GROUPS, SHARED_PATHS)
    groups = []
    for seed in range(1, SEEDS + 1):
        images = monte_carlo_replicates(
            sharing, lanes=lanes, passes=passes, replicates=GROUPS, seed=seed
        )
        groups.append(images.mean(axis=(1, 2)))
    scales = np.mean(groups, axis=1)
    # A standard deviation from n numbers is itself known to 1 / sqrt(2 (n - 1)): that over seeds
    # to a quarter, that of a run from its own groups, pooled over the seeds, to a twentieth.
    seeds = scales.std(ddof=1) / scales.mean()
    pooled = np.sqrt(np.var(groups, axis=1, ddof=1).mean() / GROUPS) / scales.mean()
    free = SEEDS * (GROUPS - 1)
    print(
        f"luminance_samples {samples}: mean {scales.mean():.4f}, standard deviation over {SEEDS} "
        f"seeds {seeds:.3%} +- {seeds / np.sqrt(2 * SEEDS - 2):.3%}, from the {GROUPS} groups of "
        f"each {pooled:.3%} +- {pooled / np.sqrt(2 * free):.3%}"
    )
    # The groups speak for the run only if runs scatter as they say: Fisher's F, both tails.
    ratio = stats.f(SEEDS - 1, free)
    assert 1e-3 < ratio.cdf((seeds / pooled) ** 2) < 1 - 1e-3
    assert seeds * np.sqrt(samples) < DEMANDED * (1 + 3 / np.sqrt(2 * SEEDS - 2))
    if samples == 10_000_000:
        assert pooled < 0.002
