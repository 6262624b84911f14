"""The preview alone against level 2, on sensors that it was not made for: errors and intervals.

Random designs on random sensors (``tests.oracles.random_scenes``) are scored on the preview and on
renders of the same cells. From the command line, for the figures in ``surrogate.preview_model``:
``python -m tests.validation.test_preview_model --sensors 16 --samples 80``.
"""

from __future__ import annotations

import argparse
from dataclasses import astuple, dataclass

import numpy as np
from scipy.stats import kendalltau

from render.metric import clip_counts, design_score, site_metric
from render.preview import Preview
from render.reference import render_transport
from render.scale import scene_scale
from render.scene import Scene
from surrogate.preview_model import COVERAGE, SCORE_FRACTION, preview_checker
from surrogate.training.evaluation import random_colors
from tests.long import LONG
from tests.oracles.random_scenes import random_scene

SENSORS = range(1, 17) if LONG else (4,)
SAMPLES = 200 if LONG else 40
DIRECTIONS = 4
DESIGNS = 200
NOISE_DRAWS = 4


@dataclass(frozen=True)
class Errors:
    """Errors of the preview on one sensor, without what the noise of the renders explains.

    Arguments:
        light: all light of the preview over that of the renders.
        color: median over facets of ``|c - c_reference| / |c_reference|`` (noise included).
        score_median, score_90: quantiles of ``|S - S_reference|`` over the baseline's mean M.
        tau, noise_tau: rank agreement of the scores, and what the noise of the renders would leave
            of a perfect one.
        covered: fraction of the scores that the stated 90 % interval holds.
    """

    light: float
    color: float
    score_median: float
    score_90: float
    tau: float
    noise_tau: float
    covered: float


def measured(scene: Scene, samples: int) -> Errors:
    """Return the errors of the preview of ``scene`` against renders with ``samples`` per cell."""
    rng = np.random.default_rng(5)
    phi = rng.uniform(0.0, np.pi, DIRECTIONS)
    bends = np.array(scene.bending.angles)
    scale = scene_scale(scene)
    with Preview(scene) as preview:
        drawn, _ = preview.transport(phi, bends)
    rendered = render_transport(scene, phi, bends, samples=samples)
    seen = np.isfinite(rendered.T)
    truth = np.where(seen, rendered.T, drawn)
    noise = np.where(seen, rendered.se, 0.0)

    fibers = len(drawn)
    choice = rng.integers(0, DIRECTIONS, (DESIGNS, fibers))
    power = np.eye(3)[random_colors(DESIGNS, fibers, rng)]

    def counts(cells: np.ndarray) -> np.ndarray:
        light = cells[np.arange(fibers), choice]
        colors = np.einsum("dfbsk,dfc->dbskc", light, power, optimize=True)
        return np.asarray(clip_counts(scale.exposure * colors))

    def scores(cells: np.ndarray) -> np.ndarray:
        return np.asarray(design_score(site_metric(counts(cells), scale.lam)).score)

    said, found = scores(drawn), scores(truth)
    # Noise lowers S, which takes it for spread: as much as it lowers that of the preview.
    noisy = [
        scores(np.maximum(drawn + noise * rng.standard_normal(noise.shape), 0.0)) - said
        for _ in range(NOISE_DRAWS)
    ]
    error = said - (found - np.mean(noisy, axis=0))
    random = np.std(noisy, axis=0, ddof=1)
    half_width = preview_checker(scene).score_half_width
    mean = half_width / SCORE_FRACTION
    off = np.linalg.norm(counts(drawn) - counts(truth), axis=-1)
    half = np.hypot(half_width, 1.645 * random)
    return Errors(
        light=float(drawn[seen].sum() / truth[seen].sum()),
        color=float(np.median(off / np.linalg.norm(counts(truth), axis=-1))),
        score_median=float(np.median(np.abs(error)) / mean),
        score_90=float(np.quantile(np.abs(error), 0.9) / mean),
        tau=float(kendalltau(said, found).statistic),
        noise_tau=float(np.mean([kendalltau(said, said + one).statistic for one in noisy])),
        covered=float(np.mean(np.abs(error) <= half)),
    )


def test_the_preview_ranks_designs_and_its_intervals_hold() -> None:
    found = [measured(random_scene(number), SAMPLES) for number in SENSORS]
    assert np.mean([errors.covered for errors in found]) > COVERAGE - 0.05
    assert np.mean([errors.tau - errors.noise_tau for errors in found]) > -0.15


def main() -> None:
    """Print the errors on many sensors."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--sensors", type=int, default=16)
    parser.add_argument("--samples", type=int, default=80)
    asked = parser.parse_args()
    titles = ("sensor", "light", "color", "S med", "S 90%", "tau", "noise", "covered")
    print("".join(f"{title:>9}" for title in titles))
    for number in range(1, asked.sensors + 1):
        errors = measured(random_scene(number), asked.samples)
        print(f"{number:>9}" + "".join(f"{value:9.3f}" for value in astuple(errors)), flush=True)


if __name__ == "__main__":
    main()
