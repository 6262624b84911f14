"""How sure the fit is: noise and differences between photographs, the table, and the model itself.

They are carried to the parameters by the fit's own linearisation:

- photographs: the sandwich estimate with one cluster per photograph, which holds however the
  residuals within one photograph hang together;
- table: the errors of the drawn materials, each left out in turn;
- model: smooth random fields of the size of the preview's error, half of it common to all fibers;
- renders, in place of the model once they have corrected it: what they leave open.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hw.calibration.material import NAMES
from hw.calibration.reference_lines import frame_positions
from render.bending import Array

if TYPE_CHECKING:
    from hw.calibration.problem import Problem

FIELDS = 200
REACH = 4.0
"""Distance (mm) over which the model's error changes."""
Z95 = 1.96
RELATED = 0.9
"""Correlation from which two values are called hard to tell apart."""


@dataclass(frozen=True, eq=False)
class Intervals:
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
        return [
            (max(float(value - Z95 * se), 0.0), float(value + Z95 * se))
            for value, se in zip(values, self.material, strict=True)
        ]

    def related(self) -> list[tuple[str, str, float]]:
        """Return pairs of values that these photographs hardly tell apart."""
        return [
            (NAMES[i], NAMES[j], float(self.correlation[i, j]))
            for i in range(4)
            for j in range(i)
            if abs(self.correlation[i, j]) >= RELATED
        ]


def intervals(problem: Problem, x: Array) -> Intervals:
    """Return the standard errors at the fit's end ``x``."""
    jacobian = problem.jacobian(x)
    scale = problem.scale()
    # Scaled normal equations: the parameters' sizes differ by orders, their derivatives do not.
    scaled = jacobian * scale
    solve = scale[:, None] * np.linalg.pinv(scaled.T @ scaled, hermitian=True) @ scaled.T
    residuals = problem.residuals(x)
    pieces = [
        solve[:, a:b] @ residuals[a:b]
        for a, b in itertools.pairwise(problem.edges * len(problem.channels))
    ]
    count = len(pieces)
    parts = {
        # Each photograph has had a power of its own fitted away.
        "photographs": np.sum([np.outer(p, p) for p in pieces], axis=0) * count / max(count - 8, 1),
    }
    drawn = problem.as_residuals(x, problem.table.errors(x[:4])) @ solve.T
    parts["table"] = drawn.T @ drawn
    if problem.draws is None:
        parts["model"] = _spread(problem.as_residuals(x, _fields(problem)) @ solve.T)
    else:
        parts["renders"] = _spread(problem.as_residuals(x, problem.draws) @ solve.T)
    covariance = np.sum(list(parts.values()), axis=0)
    se = np.sqrt(np.diag(covariance))
    fibers, gains = len(problem.fibers), len(problem.channels)
    # Powers have mean 1: the first fiber's error is that of the others' mean.
    to_log = np.zeros((fibers, len(x)))
    to_log[1:, 8 : 8 + fibers - 1] = np.eye(fibers - 1)
    power, _ = problem.unpack(x)
    to_log -= (power[:, None] * to_log).sum(axis=0) / fibers
    material = covariance[:4, :4]
    outer = np.sqrt(np.outer(np.diag(material), np.diag(material)))
    return Intervals(
        material=se[:4],
        parts={name: np.sqrt(np.diag(part)[:4]) for name, part in parts.items()},
        power=np.sqrt(np.einsum("fi,ij,fj->f", to_log, covariance, to_log)),
        gain=se[len(x) - gains :],
        correlation=material / np.where(outer > 0, outer, 1.0),
    )


def _spread(errors: Array) -> Array:
    """Return the mean outer product of ``(n, parameter)`` errors."""
    return np.asarray(errors.T @ errors / len(errors))


def _fields(problem: Problem) -> Array:
    """Return random log errors ``(field, bend, fiber, point)``, smooth in the fiber's frame."""
    rng = np.random.default_rng(3)
    place = frame_positions()
    distance = np.linalg.norm(place[:, None] - place[None], axis=-1)
    root = np.linalg.cholesky(np.exp(-0.5 * (distance / REACH) ** 2) + 1e-8 * np.eye(len(place)))
    bends, fibers = problem.table.coefficients.shape[1:3]
    common = rng.standard_normal((FIELDS, bends, 1, len(place))) @ root.T
    own = rng.standard_normal((FIELDS, bends, fibers, len(place))) @ root.T
    return np.asarray(problem.discrepancy[:, None, None] * np.sqrt(0.5) * (common + own))
