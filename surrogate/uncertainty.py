"""Uncertainty that holds: the spread of a cell, and conformal factors that make it an interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from render.bending import Array
from surrogate.heldout import Exam

COVERAGE = 0.9


def fit_spread(
    error: Array, noise: Array, ensemble: Array, brightness: Array
) -> tuple[float, float]:
    """Return ``(b0, b1)`` of the residual's standard deviation ``exp(b0 + b1 z)`` in log T.

    Maximum likelihood of normal errors with the variance ``exp(2 b0 + 2 b1 z) + ensemble +
    noise^2``: the reference's noise is not blamed on the model. Errors beyond the 99th percentile
    are left to the conformal factor. All arguments are one-dimensional, one entry per cell.

    Arguments:
        error: out-of-fold ``T_reference / T_prediction - 1``.
        noise: relative standard error of the reference.
        ensemble: variance among the members.
        brightness: the standardised log preview z.
    """
    from scipy.optimize import minimize

    keep = np.abs(error) <= np.quantile(np.abs(error), 0.99)
    square, known, z = error[keep] ** 2, (noise**2 + ensemble)[keep], brightness[keep]

    def loss(b: Array) -> float:
        variance = np.exp(np.clip(2 * (b[0] + b[1] * z), -30.0, 10.0)) + known
        return float(np.mean(np.log(variance) + square / variance))

    start = np.array([0.5 * np.log(max(float(np.mean(square - known)), 1e-6)), 0.0])
    best = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-7}).x
    return float(np.clip(best[0], -10.0, 1.0)), float(np.clip(best[1], -1.0, 1.0))


@dataclass(frozen=True)
class Quantiles:
    """Split conformal factors for COVERAGE (Vovk 2005; Lei et al. 2018).

    Arguments:
        counts: a facet's channel lies within ``counts * counts_spread`` of its prediction.
        score: S lies within ``score`` counts of its prediction.
    """

    counts: float
    score: float


def conformal(exam: Exam, transport: Array, spread: Array) -> Quantiles:
    """Return the factors that cover the held-out designs of ``exam``.

    Arguments:
        exam: held-out designs with their answers.
        transport: out-of-fold prediction ``(direction, fiber, bend, site, normal)``.
        spread: ``(design, bend, site, facet, 3)`` one standard deviation of the counts.
    """
    truth, guess = exam.counts(exam.reference), exam.counts(transport)
    lit = spread > 0
    ratio = np.abs(guess - truth)[lit] / spread[lit]
    score = np.abs(exam.scores(guess) - exam.scores(truth))
    return Quantiles(_quantile(ratio), _quantile(score))


def coverage(exam: Exam, transport: Array, spread: Array, quantiles: Quantiles) -> Quantiles:
    """Return the fractions of channels and of scores of ``exam`` that the intervals cover."""
    truth, guess = exam.counts(exam.reference), exam.counts(transport)
    lit = spread > 0
    inside = np.abs(guess - truth)[lit] <= quantiles.counts * spread[lit]
    score = np.abs(exam.scores(guess) - exam.scores(truth)) <= quantiles.score
    return Quantiles(float(inside.mean()), float(score.mean()))


def counts_spread(exam: Exam, transport: Array, apart: Array, cell_spread: Array) -> Array:
    """Return one standard deviation of the counts, as the exported graph computes it.

    Arguments:
        exam: gives designs, bends and exposure.
        transport: ``(direction, fiber, bend, site, normal)``.
        apart: deviation of every member from the mean in log T, ``(member, ...)`` the same.
        cell_spread: ``(direction, fiber, bend, site)`` calibrated residual in log T.

    Returns:
        ``(design, bend, site, facet, 3)``.
    """
    light = exam.designs.transport(transport[:, :, exam.bends, :, :-1])
    alone = light * exam.designs.transport(cell_spread[:, :, exam.bends])[..., None]
    power = exam.designs.power
    variance = np.einsum("dfc,dfbsk->dbskc", power**2, alone**2, optimize=True)
    if len(apart) > 1:
        for member in apart[..., :-1]:
            moved = light * exam.designs.transport(member[:, :, exam.bends])
            together = np.einsum("dfc,dfbsk->dbskc", power, moved, optimize=True)
            variance += together**2 / (len(apart) - 1)
    return np.asarray(exam.exposure * np.sqrt(variance))


def _quantile(values: Array) -> float:
    """Return the ceil((n + 1) COVERAGE)-th smallest value: the finite-sample conformal quantile."""
    n = len(values)
    rank = min(n, int(np.ceil((n + 1) * COVERAGE)))
    return float(np.partition(values, rank - 1)[rank - 1])
