"""The prediction is the model's own background, fiber by fiber."""

from __future__ import annotations

import numpy as np

from hw.check.prediction import PadPrediction
from surrogate.runtime import Checker


def test_fibers_together_are_the_models_background(
    checker: Checker, prediction: PadPrediction
) -> None:
    power = 0.3 * prediction.power
    whole = checker.run(prediction.phi[None], power[None], np.zeros(1))["background"][0, 0]
    assert whole.max() < 200
    np.testing.assert_allclose(0.3 * prediction.together, whole, rtol=0.01)


def test_light_between_nodes_is_that_of_the_model(
    checker: Checker, prediction: PadPrediction
) -> None:
    phi = np.radians([[33.0], [101.0]] * 10)
    power = np.zeros((20, 3))
    power[4, 1] = 1.0
    direct = checker.run(phi[:, 0][None], power[None], np.zeros(1))["background"][0, 0, :, 1]
    np.testing.assert_allclose(prediction.unit(phi)[4, 0], direct, rtol=0.02)


def test_light_is_never_negative(prediction: PadPrediction) -> None:
    assert (prediction.unit(np.tile(np.linspace(0, np.pi, 50), (20, 1))) > 0).all()
