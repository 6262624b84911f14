"""How errors of the fit's parameters become errors of the values that are reported."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from hw.calibration.residuals import standard_errors
from tests.hw.calibration.toy import SPACE


def test_errors_of_powers_and_gains_are_read_where_the_fit_keeps_these_parameters() -> None:
    # Four values, two that nobody asks for, the logs of two powers and of one gain: one residual
    # for each, known to 1, 2, ... 9; three fibers.
    error = np.arange(1.0, 10.0)
    problem = SimpleNamespace(
        jacobian=lambda _: np.concatenate([np.diag(1 / error), np.zeros((1, 9))]),
        scale=lambda: np.ones(9),
        residuals=lambda _: np.zeros(10),
        modes=np.zeros((1, 9)),
        projected=lambda residuals: residuals,
        unpack=lambda _: (np.ones(3), np.ones(1)),
        power_columns=slice(6, 8),
        gain_columns=slice(8, 9),
        material=slice(0, 4),
        space=SPACE,
        known_over_held=np.array([6.0]),
        used=20,
        rows=9,
        fibers=[0, 1, 2],
        channels=[0],
    )
    found = standard_errors(problem, np.zeros(9))  # type: ignore[arg-type]
    np.testing.assert_allclose(found.material, error[:4])
    np.testing.assert_allclose(found.gain, error[8:])
    # log(p_1 / mean) moves by 2/3 of log p_1 and -1/3 of log p_2.
    moves = np.array([[-1, -1], [2, -1], [-1, 2]]) / 3
    np.testing.assert_allclose(found.power, np.hypot(*(moves * error[6:8]).T))
