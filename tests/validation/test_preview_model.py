"""The preview alone against level 2, on sensors that it was not made for: errors and intervals.

Random designs on random sensors (``tests.oracles.random_scenes``) are scored on both previews,
coarse and converged, and on renders of the same cells, or on cells of analog photons where there is
no diffuser: they are cheaper there, and their noise is that of counts.

From the command line, for the figures in ``surrogate.preview_model``:
``python -m tests.validation.test_preview_model 1 2 3 --samples 300 --photons 250000``.
"""

from __future__ import annotations

import argparse
from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.stats import kendalltau

from render.metric import clip_counts, design_score, site_metric
from render.reference import render_transport
from render.scale import scene_scale
from render.scene import Scene
from surrogate.preview_model import COARSE_ERRORS, CONVERGED_ERRORS, COVERAGE, preview_checker
from surrogate.runtime import Checker
from surrogate.training.evaluation import random_colors
from tests.long import LONG
from tests.oracles.analog_cells import AnalogScene
from tests.oracles.mesh_cells import BentScene
from tests.oracles.random_scenes import random_scene

SENSORS = range(1, 17) if LONG else (4,)
SAMPLES = 600 if LONG else 300
"""Fewer leave noise in S that is not normal: it cannot be taken off."""
PHOTONS = 250_000 if LONG else 100_000
DIRECTIONS = 4
DESIGNS = 200
NOISE_DRAWS = 4
DIM = 1e-3
"""Power at which no facet saturates."""


@dataclass(frozen=True)
class Errors:
    """Errors of the preview on one sensor, without what the noise of the renders explains.

    Arguments:
        light: all light of the preview over that of the renders.
        color: median over facets of ``|c - c_reference| / |c_reference|`` (noise included).
        color_noise: what the noise of the reference alone would leave of a perfect one.
        score_median, score_90: quantiles of ``|S - S_reference|`` over the baseline's mean M.
        tau, noise_tau: rank agreement of the scores, and what the noise of the renders would leave
            of a perfect one.
        covered: fraction of the scores that the stated 90 % interval holds.
    """

    light: float
    color: float
    color_noise: float
    score_median: float
    score_90: float
    tau: float
    noise_tau: float
    covered: float


def checker_transport(checker: Checker, phi: np.ndarray, bends: np.ndarray) -> np.ndarray:
    """Return transport ``(lamp, direction, bend, site, facet)`` of a model, lamp by lamp."""
    lamps = checker.metadata.fibers
    counts = [
        checker.run(
            np.repeat(phi[:, None], lamps, axis=1),
            np.tile(np.eye(lamps)[lamp][None, :, None] * DIM, (len(phi), 1, 3)),
            bends,
        )["counts"][..., 0]
        for lamp in range(lamps)
    ]
    return np.array(counts) / (DIM * checker.exposure)


class Truth(NamedTuple):
    """Transport ``(lamp, direction, bend, site, facet)`` and its standard errors."""

    T: np.ndarray
    se: np.ndarray


def traced(scene: Scene, phi: np.ndarray, photons: int) -> Truth:
    """Return what analog photons find, so many a lamp, direction and bend."""
    pads = [
        BentScene(scene, bend) if bend else AnalogScene(scene, True)
        for bend in scene.bending.angles
    ]
    batches = np.array(
        [
            [[pad.cells(lamp, at, photons).replicates for pad in pads] for at in phi]
            for lamp in range(scene.lamp_count)
        ]
    )
    shape = (*batches.shape[:3], -1, scene.indenter.faces)
    mean, error = batches.mean(axis=3), stats.sem(batches, axis=3)
    return Truth(mean.reshape(shape), error.reshape(shape))


def measured(scene: Scene, samples: int, photons: int = 0) -> tuple[Errors, Errors]:
    """Return the errors of both previews of ``scene``: of the coarse and of the converged one.

    Against renders with ``samples`` per cell, or where there is no diffuser ``photons`` if any.
    """
    phi = np.random.default_rng(5).uniform(0.0, np.pi, DIRECTIONS)
    if photons and scene.diffuser is None:
        truth = traced(scene, phi, photons)
    else:
        found = render_transport(scene, phi, np.array(scene.bending.angles), samples=samples)
        truth = Truth(found.T, found.se)
    return _measured(scene, phi, truth, True), _measured(scene, phi, truth, False)


def _measured(scene: Scene, phi: np.ndarray, rendered: Truth, coarse: bool) -> Errors:
    rng = np.random.default_rng(6)
    scale, checker = scene_scale(scene), preview_checker(scene, coarse=coarse)
    drawn = checker_transport(checker, phi, np.array(scene.bending.angles))
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
    redrawn = [
        np.maximum(drawn + noise * rng.standard_normal(noise.shape), 0.0)
        for _ in range(NOISE_DRAWS)
    ]
    noisy = [scores(cells) - said for cells in redrawn]
    error = said - (found - np.mean(noisy, axis=0))
    random = np.std(noisy, axis=0, ddof=1)
    half_width = checker.score_half_width
    mean = half_width / (COARSE_ERRORS if coarse else CONVERGED_ERRORS).score_fraction

    def off(cells: np.ndarray, known: np.ndarray) -> float:
        light = np.linalg.norm(counts(known), axis=-1)
        lit = light > 0
        return float(
            np.median(np.linalg.norm(counts(cells) - counts(known), axis=-1)[lit] / light[lit])
        )

    half = np.hypot(half_width, 1.645 * random)
    return Errors(
        light=float(drawn[seen].sum() / truth[seen].sum()),
        color=off(drawn, truth),
        color_noise=off(drawn, redrawn[0]),
        score_median=float(np.median(np.abs(error)) / mean),
        score_90=float(np.quantile(np.abs(error), 0.9) / mean),
        tau=float(kendalltau(said, found).statistic),
        noise_tau=float(np.mean([kendalltau(said, said + one).statistic for one in noisy])),
        covered=float(np.mean(np.abs(error) <= half)),
    )


def test_the_preview_ranks_designs_and_its_intervals_hold() -> None:
    coarse, converged = zip(
        *(measured(random_scene(number), SAMPLES, PHOTONS) for number in SENSORS), strict=True
    )
    for found in (coarse, converged):
        assert np.mean([errors.covered for errors in found]) > COVERAGE - 0.05
        assert np.mean([errors.tau - errors.noise_tau for errors in found]) > -0.15
    assert np.mean([errors.color - errors.color_noise for errors in converged]) < 0.02


def main() -> None:
    """Print the errors on many sensors."""
    parser = argparse.ArgumentParser()
    parser.add_argument("sensors", type=int, nargs="*", default=range(1, 17))
    parser.add_argument("--samples", type=int, default=80)
    parser.add_argument("--photons", type=int, default=PHOTONS)
    asked = parser.parse_args()
    titles = ("sensor", "light", "color", "noise", "S med", "S 90%", "tau", "noise", "covered")
    print("".join(f"{title:>9}" for title in titles))
    for number in asked.sensors:
        for errors in measured(random_scene(number), asked.samples, asked.photons):
            row = "".join(f"{value:9.3f}" for value in astuple(errors))
            print(f"{number:>9}{row}", flush=True)


if __name__ == "__main__":
    main()
