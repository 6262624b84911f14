"""The preview alone on sensors that it was not made for: errors, and intervals that they calibrate.

Random designs on random sensors (``tests.oracles.random_scenes``) are scored on both previews,
coarse and converged, and on cells of analog photons.

From the command line, for the factors in ``surrogate.preview_interval``:
``python -m tests.validation.test_preview_model 1 2 digit --photons 300000 --keep FOLDER``. Numbers
are random sensors (``13@3``: with beams of 3 deg), names shipped scenes; what was traced is kept in
the folder. ``--models FOLDER`` adds a row for the model of each that ``tactilux train`` has made
there, under the scene's name.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats
from scipy.stats import kendalltau

from render.choose_exposure import baseline_power, scene_scale
from render.files import read_or_drop, write_npz
from render.geometry import counted_sites
from render.metric import clip_counts, design_score, site_metric
from render.scene import Scene, load_scene
from surrogate.preview_interval import COVERAGE
from surrogate.preview_model import (
    COARSE_ERRORS,
    CONVERGED_ERRORS,
    FEW_PATHS_ERRORS,
    few_paths_checker,
    preview_checker,
)
from surrogate.runtime import Checker
from surrogate.training.evaluation import random_colors
from tests.long import LONG
from tests.oracles.kept_photons import analog
from tests.oracles.random_scenes import random_scene, with_beams

SENSORS = ("2", "4", "6", "10", "13", "19", "20") if LONG else ("4",)
PHOTONS = 250_000 if LONG else 100_000
DIRECTIONS = 4
DESIGNS = 200
NOISE_DRAWS = 16
DIM = 1e-3
"""Power at which no facet saturates."""
SPREADS = {one.effort: one.color_spread for one in (COARSE_ERRORS, FEW_PATHS_ERRORS)}
NORMAL = 1.645
"""Normal errors of deviation 1 are within this as often as `COVERAGE` says."""


@dataclass(frozen=True)
class Errors:
    """Errors of a preview on one sensor, without what the noise of the truth explains.

    Arguments:
        light: all light of the preview over that of the truth.
        color: median over facets of ``|c - c_reference| / |c_reference|`` (noise included).
        color_noise: what the noise of the truth alone would leave of a perfect one.
        score_median, score_90: quantiles of ``|S - S_reference|`` over the baseline's mean M.
        tau, noise_tau: rank agreement of the scores, and what the noise of the truth would leave
            of a perfect one.
        half_width: of the stated 90 % interval of a score, over M.
        covered: fraction of the scores that it holds.
        colors_covered: fraction of the channels of facets that their interval holds.
    """

    light: float
    color: float
    color_noise: float
    score_median: float
    score_90: float
    tau: float
    noise_tau: float
    half_width: float
    covered: float
    colors_covered: float


class ScoreErrors(NamedTuple):
    """What calibrates intervals of one preview on one sensor, all over the baseline's mean M.

    ``error`` and ``noise`` of the truth are ``(design,)``; ``scale`` is the stated half-width.
    """

    error: np.ndarray
    noise: np.ndarray
    scale: float

    def covered(self, factor: float) -> float:
        """Return the fraction of scores within ``factor`` times the scale, noise allowed for."""
        half_width = np.hypot(factor * self.scale, NORMAL * self.noise)
        return float(np.mean(np.abs(self.error) <= half_width))


def calibrated(sensors: Sequence[ScoreErrors]) -> float:
    """Return the least factor that holds `COVERAGE` of the scores, all sensors weighing alike."""
    low, high = 0.0, 1e3
    for _ in range(60):
        factor = 0.5 * (low + high)
        if np.mean([one.covered(factor) for one in sensors]) >= COVERAGE:
            high = factor
        else:
            low = factor
    return high


def left_out(sensors: Sequence[ScoreErrors]) -> list[float]:
    """Return what each sensor's intervals hold by the factor that the others calibrate."""
    return [
        one.covered(calibrated([*sensors[:i], *sensors[i + 1 :]])) for i, one in enumerate(sensors)
    ]


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


@dataclass(frozen=True)
class Truth:
    """What batches of photons find: transport ``(batch, lamp, direction, bend, site, facet)``.

    The camera mixes facets and the coating between them, so what it sees of two of one site is
    wrong by the same photons: their noise is redrawn together.
    """

    batches: np.ndarray

    @property
    def T(self) -> np.ndarray:
        """Transport by all photons."""
        return np.asarray(self.batches.mean(axis=0))

    def noise(self, rng: np.random.Generator) -> np.ndarray:
        """Return errors of `T` as other photons would make them; all cells of a lamp together."""
        count, *lit = self.batches.shape[:4]
        chosen = rng.standard_normal((count, *lit)) / np.sqrt(count * (count - 1))
        return np.asarray(np.einsum("nfdb,nfdbsk->fdbsk", chosen, self.batches - self.T))

    @property
    def se(self) -> np.ndarray:
        """Standard errors of single cells."""
        return np.asarray(stats.sem(self.batches, axis=0))


def traced(scene: Scene, phi: np.ndarray, photons: int) -> Truth:
    """Return what analog photons find, so many a lamp, direction and bend."""
    pads = [analog(scene, pressed=True, bend=bend) for bend in scene.bending.angles]
    batches = np.array(
        [
            [[pad.cells(lamp, at, photons).replicates for pad in pads] for at in phi]
            for lamp in range(scene.lamp_count)
        ]
    )
    batches = np.moveaxis(batches, 3, 0)
    return Truth(batches.reshape(*batches.shape[:4], -1, scene.indenter.faces))


def sensor(name: str) -> Scene:
    """Return the random sensor of a number, with beams of so many deg, or the scene of a name."""
    number, _, beam = name.partition("@")
    if not number.isdigit():
        return load_scene(name)
    return with_beams(int(number), float(beam)) if beam else random_scene(int(number))


def directions(scene: Scene) -> np.ndarray:
    """Return what all lamps are traced in, rad; one where none turns."""
    phi = np.random.default_rng(5).uniform(0.0, np.pi, DIRECTIONS)
    return phi if any(scene.turning) else phi[:1]


def measured(
    scene: Scene, photons: int, keep: Path | None = None, models: Path | None = None
) -> list[tuple[Errors, ScoreErrors]]:
    """Return the errors of each preview of ``scene``, and of its model.

    Against ``photons`` a lamp, direction and bend. The last are left out where ``models`` has none
    of its name.
    """
    phi = directions(scene)
    file = None if keep is None else keep / f"{scene.name}-{scene.hash}-{photons}.npz"
    kept = None if file is None else read_or_drop(file, "batches")
    truth = traced(scene, phi, photons) if kept is None else Truth(kept["batches"])
    if file is not None and kept is None:
        write_npz(file, {"batches": truth.batches})
    previews = [
        preview_checker(scene, coarse=True), few_paths_checker(scene), preview_checker(scene),
    ]  # fmt: skip
    straight = np.full((1, scene.lamp_count), np.pi / 2)
    metric = previews[-1].run(straight, baseline_power(scene)[None], np.array(scene.state_axis))
    mean = float(design_score(metric["metric"]).mean[0])
    found = [_measured(scene, phi, truth, one, mean) for one in previews]
    if models is not None and (models / scene.name / "checker.onnx").is_file():
        trained = Checker.for_scene(models / scene.name, scene)
        found.append(_measured(scene, phi, truth, trained, mean))
    return found


def _measured(
    scene: Scene, phi: np.ndarray, found: Truth, checker: Checker, mean: float
) -> tuple[Errors, ScoreErrors]:
    rng = np.random.default_rng(6)
    settings = scene_scale(scene)
    drawn = checker_transport(checker, phi, np.array(scene.bending.angles))
    # Photons go to every site, scores to those that count.
    found = Truth(found.batches[..., counted_sites(scene), :])
    seen = np.isfinite(found.T)
    truth = np.where(seen, found.T, drawn)

    fibers = len(drawn)
    choice = rng.integers(0, len(phi), (DESIGNS, fibers))
    power = np.eye(3)[random_colors(DESIGNS, fibers, rng)]

    def counts(cells: np.ndarray) -> np.ndarray:
        light = cells[np.arange(fibers), choice]
        colors = np.einsum("dfbsk,dfc->dbskc", light, power, optimize=True)
        return np.asarray(clip_counts(settings.exposure * colors))

    def scores(cells: np.ndarray) -> np.ndarray:
        return np.asarray(design_score(site_metric(counts(cells), settings.lam)).score)

    said, true_scores = scores(drawn), scores(truth)
    # Noise lowers S, which takes it for spread: as much as it lowers that of the preview.
    redrawn = [
        np.maximum(drawn + np.where(seen, found.noise(rng), 0.0), 0.0) for _ in range(NOISE_DRAWS)
    ]
    noisy = [scores(cells) - said for cells in redrawn]
    error = said - (true_scores - np.mean(noisy, axis=0))
    random = np.std(noisy, axis=0, ddof=1)
    half_width = checker.score_half_width

    def off(cells: np.ndarray, known: np.ndarray) -> float:
        light = np.linalg.norm(counts(known), axis=-1)
        lit = light > 0
        return float(
            np.median(np.linalg.norm(counts(cells) - counts(known), axis=-1)[lit] / light[lit])
        )

    variance = np.where(seen, found.se**2, 0.0)[np.arange(fibers), choice]
    variance = np.einsum("dfbsk,dfc->dbskc", variance, power**2, optimize=True)
    channels = counts(drawn)
    spread = SPREADS.get(checker.effort, CONVERGED_ERRORS.color_spread)
    color_half = np.hypot(
        checker.counts_factor * spread * channels, NORMAL * settings.exposure * np.sqrt(variance)
    )
    lit = channels > 1.0
    ours = ScoreErrors(error / mean, random / mean, half_width / mean)
    return Errors(
        light=float(drawn[seen].sum() / truth[seen].sum()),
        color=off(drawn, truth),
        color_noise=off(drawn, redrawn[0]),
        score_median=float(np.median(np.abs(error)) / mean),
        score_90=float(np.quantile(np.abs(error), 0.9) / mean),
        tau=float(kendalltau(said, true_scores).statistic),
        noise_tau=float(np.mean([kendalltau(said, said + one).statistic for one in noisy])),
        half_width=half_width / mean,
        covered=ours.covered(1.0),
        colors_covered=float(np.mean((np.abs(channels - counts(truth)) <= color_half)[lit])),
    ), ours


def test_intervals_hold_as_often_as_they_state_whatever_the_noise() -> None:
    rng = np.random.default_rng(0)
    sensors = []
    for scale, noise in ((0.01, 0.0), (0.1, 0.05), (0.03, 0.1), (0.05, 0.02)):
        error = 2.0 * scale * rng.standard_normal(20_000) + noise * rng.standard_normal(20_000)
        sensors.append(ScoreErrors(error, np.full(20_000, noise), scale))
    factor = calibrated(sensors)
    assert abs(factor / (2.0 * NORMAL) - 1.0) < 0.02
    assert np.abs(np.array(left_out(sensors)) - COVERAGE).max() < 0.01


def test_noise_is_redrawn_as_cells_share_it_and_lamps_do_not() -> None:
    rng = np.random.default_rng(0)
    # Two cells of a site have nine tenths of their variance by the same photons.
    shared, own = rng.standard_normal((16, 3, 1, 1, 1, 1)), rng.standard_normal((16, 3, 1, 1, 1, 2))
    batches = 1.0 + np.sqrt(0.9) * shared + np.sqrt(0.1) * own
    truth = Truth(batches)
    drawn = np.array([truth.noise(rng) for _ in range(20_000)])[:, :, 0, 0, 0]
    for lamp, cells in enumerate(batches[:, :, 0, 0, 0].swapaxes(0, 1)):
        np.testing.assert_allclose(
            np.cov(drawn[:, lamp], rowvar=False), np.cov(cells, rowvar=False) / 16, rtol=0.06
        )
    sums = drawn.sum(axis=-1)
    assert np.abs(np.corrcoef(sums, rowvar=False) - np.eye(3)).max() < 0.03


def test_the_preview_ranks_designs_and_its_intervals_hold() -> None:
    coarse, few_paths, converged = zip(
        *([errors for errors, _ in measured(sensor(name), PHOTONS)] for name in SENSORS),
        strict=True,
    )
    for found in (coarse, few_paths, converged):
        assert np.mean([errors.covered for errors in found]) > COVERAGE - 0.05
        assert np.mean([errors.tau - errors.noise_tau for errors in found]) > -0.15
    assert np.mean([errors.color - errors.color_noise for errors in converged]) < 0.02
    assert np.mean([errors.half_width for errors in converged]) < 0.05


@pytest.mark.skipif(not LONG, reason="part of make validation-long")
def test_narrow_beams_light_what_they_light_between_directions() -> None:
    """None of the directions that photons go is one that the preview was made in."""
    converged, _ = measured(sensor("13@3"), PHOTONS)[-1]
    assert abs(converged.light - 1.0) < 0.03
    assert converged.color - converged.color_noise < 0.04


def main() -> None:
    """Print the errors on many sensors, and the factors that they calibrate."""
    parser = argparse.ArgumentParser()
    parser.add_argument("sensors", nargs="*", default=list(map(str, range(1, 17))))
    parser.add_argument("--photons", type=int, default=PHOTONS)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--models", type=Path)
    asked = parser.parse_args()
    titles = (
        "sensor", "light", "color", "noise", "S med", "S 90%", "tau", "noise", "half", "held",
        "colors",
    )  # fmt: skip
    print("".join(f"{title:>9}" for title in titles))
    calibrating: list[list[ScoreErrors]] = [[], [], []]
    for name in asked.sensors:
        found = measured(sensor(name), asked.photons, asked.keep, asked.models)
        for i, (errors, ours) in enumerate(found):
            row = "".join(f"{value:9.3f}" for value in astuple(errors))
            print(f"{name:>9.9}{row}", flush=True)
            if i < len(calibrating):
                calibrating[i].append(ours)
    if len(asked.sensors) < 2:
        return
    for title, kind in zip(("as drawn", "few paths", "converged"), calibrating, strict=True):
        held = " ".join(f"{one:.2f}" for one in left_out(kind))
        print(
            f"{title}: stated intervals times {calibrated(kind):.2f}; "
            f"by the factor of the others held {held}"
        )


if __name__ == "__main__":
    main()
