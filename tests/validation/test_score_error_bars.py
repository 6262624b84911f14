"""Error bars of rendered scores, on renders that are simulated: what they hold, and when they say.

The light of a preview stands for the truth. Renders are that, times gamma noise in every cell, part
of it common to the facets of a site. From the command line, the table of ``RESULTS.md``:
``python -m tests.validation.test_score_error_bars 2 4 finger20 digit gelsight-mini``.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np

from optimize.design import ScoreSettings
from optimize.scoring import noise_doubt, paired_difference, rendered_score
from render.choose_exposure import baseline_power, scene_scale
from render.noise_share import noise_share
from surrogate.preview_model import preview_checker
from surrogate.training.evaluation import random_colors
from tests.validation.test_preview_model import checker_transport, sensor

NOISE = (0.03, 0.07, 0.14, 0.2, 0.28, 0.4, 0.6)
COMMON = 0.3
"""Of the variance: common to a site's facets, where the cells are those of a diffuser."""
DESIGNS = 3
COVERAGE = 0.9


class Simulated(NamedTuple):
    """What renders of one noise say of designs, the baseline first.

    Arguments:
        held: fraction of the 90 % intervals that hold S, by design.
        difference: the same of what the second design has over the baseline.
        bias: mean error of S in counts, by design.
        share: `noise_share` in the mean, by design.
        doubted: fraction of the renders that say that S has not converged, by design.
        held_undoubted: fraction of the 90 % intervals that hold S, of those that do not say so.
    """

    held: np.ndarray
    difference: float
    bias: np.ndarray
    share: np.ndarray
    doubted: np.ndarray
    held_undoubted: float


class Lighting(NamedTuple):
    """Transport ``(lamp, bend, site, facet)`` of a preview, and how designs are scored on it."""

    light: np.ndarray
    settings: ScoreSettings
    powers: list[np.ndarray]
    common: float


def lighting(name: str) -> Lighting:
    """Return the drawn preview of the scene, its baseline and random colors."""
    scene = sensor(name)
    checker = preview_checker(scene, coarse=True)
    bends = np.array(scene.state_axis)
    light = checker_transport(checker, np.array([np.pi / 2]), bends)[:, 0].astype(np.float64)
    scale = scene_scale(scene)
    colors = random_colors(DESIGNS - 1, scene.lamp_count, np.random.default_rng(11))
    powers = [baseline_power(scene), *np.eye(3)[colors]]
    settings = ScoreSettings(scale.exposure, scale.lam)
    return Lighting(light, settings, powers, COMMON if scene.diffuser else 0.0)


def simulated(sensor: Lighting, noise: float, repetitions: int, replicates: int = 8) -> Simulated:
    """Return what renders say whose mean has the relative ``noise`` in a cell."""
    light, settings, powers, common = sensor
    truth = [float(settings.parts(light, power)[0]) for power in powers]
    rows = []
    for repetition in range(repetitions):
        rng = np.random.default_rng([repetition, round(1000 * noise)])
        drawn = light * np.ones((replicates, 1, 1, 1, 1))
        for part, axes in ((common, (*light.shape[:-1], 1)), (1.0 - common, light.shape)):
            variance = max(part * replicates * noise**2, 1e-12)
            drawn = drawn * rng.gamma(1.0 / variance, variance, (replicates, *axes))
        for power, known in zip(powers, truth, strict=True):
            score = rendered_score(settings, drawn, power).score
            low, high = score.interval(COVERAGE)
            share = noise_share(drawn, power, settings.exposure)
            doubted = bool(noise_doubt(settings, drawn, power))
            rows.append((low <= known <= high, score.value - known, share, doubted))
        gain = paired_difference(settings, drawn, powers[0], drawn, powers[1])
        low, high = gain.interval(COVERAGE)
        rows.append((low <= truth[1] - truth[0] <= high, 0.0, 0.0, False))
    table = np.array(rows, dtype=float).reshape(repetitions, -1, 4)
    held, bias, share, doubted = np.moveaxis(table, -1, 0)
    kept = doubted[:, :-1] == 0
    return Simulated(
        held[:, :-1].mean(axis=0),
        float(held[:, -1].mean()),
        bias[:, :-1].mean(axis=0),
        share[:, :-1].mean(axis=0),
        doubted[:, :-1].mean(axis=0),
        float(held[:, :-1][kept].mean()) if kept.any() else np.nan,
    )


def test_scores_of_noisy_renders_are_held_or_said_not_to_have_converged() -> None:
    clear = lighting("4")
    low, middle, high = (simulated(clear, noise, 30) for noise in (0.1, 0.2, 0.6))
    assert not low.doubted.any()
    assert low.held_undoubted > 0.8
    # A pale pad, whose hue's mean and spread have biases that nearly cancel in halves.
    assert middle.share[0] < 0.4
    assert middle.held.min() > 0.85
    # No resampling finds all of the bias there.
    assert abs(high.bias[0]) > 10.0
    assert high.doubted.min() > 0.9


def main() -> None:
    """Print a row for each sensor and noise."""
    parser = argparse.ArgumentParser()
    parser.add_argument("sensors", nargs="+")
    parser.add_argument("--repetitions", type=int, default=60)
    asked = parser.parse_args()
    print(
        f"{'sensor':>14} noise   held by design  diff  bias, counts        share of noise  doubted"
    )
    for name in asked.sensors:
        known = lighting(name)
        for noise in NOISE:
            found = simulated(known, noise, asked.repetitions)
            held, bias, share, doubted = (
                " ".join(f"{value:{width}}" for value in values)
                for values, width in (
                    (found.held, "4.2f"),
                    (found.bias, "6.1f"),
                    (found.share, "4.2f"),
                    (found.doubted, "4.2f"),
                )
            )
            print(
                f"{name:>14} {noise:5.2f} {held} {found.difference:6.2f} {bias}  {share}  {doubted}"
                f"  others held {found.held_undoubted:.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
