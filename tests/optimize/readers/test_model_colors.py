"""What a model may be off by: its spread, what designs share, and intervals of what is picked."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import dimmed_baseline
from optimize.objectives import READERS, ReaderName
from optimize.readers import CameraModel, ModelColors, expected_error
from optimize.readers.model_colors import DRAWS, drawn_errors, likely_errors, model_offsets
from optimize.scoring import predicted_spread, search_table, trained_model
from render.scene import Scene, load_scene
from surrogate.runtime import Checker


def test_errors_deviate_by_the_spread_of_the_model(
    finger20: Scene, finger20_checker: Checker
) -> None:
    design = dimmed_baseline(finger20)
    spread = predicted_spread(finger20_checker, design)
    errors = likely_errors(finger20_checker, design)
    assert errors.shape == (DRAWS, *spread.shape)
    unit = errors / spread
    assert np.sqrt(np.mean(unit**2)) == pytest.approx(1.0, abs=0.03)
    # Half of the variance is common to the facets that one lamp lights.
    facets = unit[:, :, :, :-1]
    between = np.mean(facets.mean(axis=3) ** 2)
    assert 0.3 <= between <= 0.7


def test_only_lamps_that_change_have_other_errors(
    finger20: Scene, finger20_checker: Checker
) -> None:
    design = dimmed_baseline(finger20)
    model = ModelColors.of(finger20_checker, [design, design])
    assert model is not None
    np.testing.assert_array_equal(model.errors[:, 0], model.errors[:, 1])
    turned = replace(design, phi=design.phi + 0.2 * (np.arange(len(design.phi)) == 0))
    one, other = (likely_errors(finger20_checker, each) for each in (design, turned))
    both = np.corrcoef(one.ravel(), other.ravel())[0, 1]
    assert 0.7 < both < 0.999


@pytest.mark.parametrize("reader", READERS)
def test_intervals_hold_what_is_best_by_a_model_of_known_errors(reader: ReaderName) -> None:
    scene = load_scene("digit")
    checker, camera = trained_model(scene), CameraModel.of(scene)
    assert checker is not None
    error, table = expected_error(reader, scene, camera), search_table(checker)
    mean, palette = table.exposure * table.with_pad[:, 0], scene.palette.matrix
    power = palette[list(itertools.product(range(len(palette)), repeat=scene.lamp_count))]
    power = power[power.any(axis=1).all(axis=1)]
    rng, held = np.random.default_rng(1), []

    def likely(size: float) -> np.ndarray:
        common = rng.standard_normal((*mean.shape[:-1], 1))
        return size * (common + rng.standard_normal(mean.shape)) / np.sqrt(2.0)

    def colors(light: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("fbsk,...fc->...bskc", light, chosen))

    for number in range(60):
        # The best mean of a preview and of renders of equal noise has half of their variance.
        true = mean * (1.0 + likely(0.04))
        model = mean + 0.5 * (true + mean * likely(0.04) - mean)
        best = power[error.degrees(colors(model, power)).argmin()]
        spread = 0.04 / np.sqrt(2.0) * np.sqrt(np.einsum("fbsk,fc->bskc", mean**2, best**2))
        lamps = ((colors(model[[f]], best[[f]]), [number, f]) for f in range(len(best)))
        told = ModelColors(colors(model, best)[None], drawn_errors(spread, lamps)[:, None])
        half = 1.645 * np.sqrt(np.mean(model_offsets(scene, told, camera)[reader] ** 2))
        missed = np.diff(error.degrees(np.stack([colors(light, best) for light in (model, true)])))
        held.append(abs(float(missed[0])) <= half)
    # Of 60 intervals of 90 % fewer than 47 hold once in 170 times.
    assert np.mean(held) >= 47 / 60
