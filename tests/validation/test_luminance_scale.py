"""The luminance scale against ``luminance_samples``: thesis Fig. 3.3 on the slab with a disk light.

The scale fixes the mean intensity of a Metropolis picture; Mitsuba 0.6 needs 1e7 samples for a
standard deviation of 0.2 %.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np

from tests.validation.film import LONG
from tests.validation.test_slab_reference import lamp, slab

SEEDS = 8
SAMPLES = [65_536, 100_000, 1_000_000, 10_000_000] if LONG else [65_536]
"""Of these some start the chains and an eighth is the pilot; the rest fixes the scale."""
CHAINS = 4096
DEMANDED = 0.002 * np.sqrt(1e7)
"""Relative standard deviation times the root of ``luminance_samples``."""


def test_the_mean_intensity_scatters_less_than_0_2_percent_at_ten_million_samples(
    mono: ModuleType, tmp_path: Path
) -> None:
    from render.film_paths import Limits
    from render.film_problem import FilmProblem
    from render.film_scale import FilmScale

    scene = slab(mono, tmp_path, lamp(mono))
    problem = FilmProblem(scene, scene.sensors()[0], Limits())
    weights = np.ones((problem.bins, problem.channels)) / problem.bins
    spread = {}
    for samples in SAMPLES:
        scales = []
        for seed in range(1, SEEDS + 1):
            run = FilmScale(problem, samples, CHAINS, 8, seed)
            run.pilot()
            scales.append(run.means(weights).mean())
        spread[samples] = float(np.std(scales, ddof=1) / np.mean(scales))
        # A standard deviation from few seeds is itself known to 1 / sqrt(2 (seeds - 1)).
        print(
            f"luminance_samples {samples}: mean {np.mean(scales):.4f}, standard deviation over "
            f"{SEEDS} seeds {spread[samples]:.2%} +- {spread[samples] / np.sqrt(2 * SEEDS - 2):.2%}"
        )
    slack = 1 + 3 / np.sqrt(2 * SEEDS - 2)
    for samples, found in spread.items():
        assert found * np.sqrt(samples) < DEMANDED * slack
    if LONG:
        assert spread[10_000_000] < 0.002
