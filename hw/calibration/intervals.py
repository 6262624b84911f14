"""How sure the fit is: noise of the photographs, and errors of the model.

They are carried to the parameters by the fit's own linearization:

- photographs: noise, enlarged where more is left than noise and model explain (Birge 1932);
- model: its error modes (``hw.calibration.model_error``): smooth fields, or what renders leave open
  once they have corrected it;
- known: the roughness, which is considered rather than fitted (Schmidt 1966).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw.calibration.material import NAMES
from hw.calibration.residuals import MATERIAL, ROUGHNESS_HELD, ROUGHNESS_KNOWN, CalibrationResiduals
from optimize.scoring import normal_factor
from render.arrays import Array

MODEL_ERROR_FACTOR = 1.8
"""By how much errors of the model exceed what its modes say. With 1, the values of five emulated
rigs were off by 1.5 standard errors in the root mean square; with this, by 1."""
MAX_CORRELATION = 0.9
"""Correlation from which two values are called hard to tell apart."""


@dataclass(frozen=True, eq=False)
class StandardErrors:
    """Standard errors of everything fitted.

    Arguments:
        material: ``(4,)`` in the order of `NAMES`; parts: the same by source of the error.
        power: ``(fiber,)`` relative, in the order of the fibers that were photographed.
        gain: ``(channel,)`` relative, of the channels that were used.
        correlation: ``(4, 4)`` of the material's values.
    """

    material: Array
    parts: dict[str, Array]
    power: Array
    gain: Array
    correlation: Array

    def of(self, values: Array) -> list[tuple[float, float]]:
        """Return 95 % intervals of the material ``values`` ``(4,)``; none reaches below 0."""
        factor = normal_factor()
        return [
            (max(float(value - factor * se), 0.0), float(value + factor * se))
            for value, se in zip(values, self.material, strict=True)
        ]

    def related(self) -> list[tuple[str, str, float]]:
        """Return pairs of values that these photographs hardly tell apart."""
        return [
            (NAMES[i], NAMES[j], float(self.correlation[i, j]))
            for i in range(4)
            for j in range(i)
            if abs(self.correlation[i, j]) >= MAX_CORRELATION
        ]


def intervals(problem: CalibrationResiduals, x: Array) -> StandardErrors:
    """Return the standard errors at the fit's end ``x``."""
    slopes, scale = problem.jacobian(x), problem.scale()
    # Scaled normal equations: the parameters' sizes differ by orders, their derivatives do not.
    scaled = slopes * scale
    inverse = scale[:, None] * np.linalg.pinv(scaled.T @ scaled, hermitian=True) * scale
    moves = inverse @ slopes.T
    # What is left of the photographs, in units of what noise and model explain; never below 1.
    left = problem.residuals(x)
    excess = max(1.0, float(left @ left) / (problem.used - len(x)))
    # Held more tightly than it is known: what is not known of it is carried to everything else.
    known = ROUGHNESS_KNOWN / ROUGHNESS_HELD * moves[:, -1:]
    moved = moves[:, :-1] @ problem.reduced(problem.mode_residuals())
    parts = {
        "photographs": excess * np.asarray(moves[:, : problem.rows] @ moves[:, : problem.rows].T),
        "model": MODEL_ERROR_FACTOR**2 * moved @ moved.T,
        "known": known @ known.T,
    }
    covariance = np.sum(list(parts.values()), axis=0)
    se = np.sqrt(np.diag(covariance))
    fibers = len(problem.fibers)
    # Powers have mean 1: the first fiber's error is that of the others' mean.
    to_log = np.zeros((fibers, len(x)))
    to_log[1:, problem.power_columns] = np.eye(fibers - 1)
    power, _ = problem.unpack(x)
    to_log -= (power[:, None] * to_log).sum(axis=0) / fibers
    material = covariance[MATERIAL, MATERIAL]
    outer = np.sqrt(np.outer(np.diag(material), np.diag(material)))
    return StandardErrors(
        material=se[MATERIAL],
        parts={name: np.sqrt(np.diag(part)[MATERIAL]) for name, part in parts.items()},
        power=np.sqrt(np.einsum("fi,ij,fj->f", to_log, covariance, to_log)),
        gain=se[problem.gain_columns],
        correlation=material / np.where(outer > 0, outer, 1.0),
    )
