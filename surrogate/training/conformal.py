"""Uncertainty that holds: the spread of a cell, and conformal factors that make it an interval.

Intervals are for the reference without its noise. A held-out render has noise of its own, which is
known; it is added in quadrature wherever a prediction is compared with a render, when factors are
found and when their coverage is checked. So a noisy reference does not widen the intervals, and a
better one does not break them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from render.arrays import Array
from render.noise_share import UNCONVERGED_SHARE, converging_effort
from surrogate.training.evaluation import HeldOutEvaluation

COVERAGE = 0.9
NORMAL = 1.645
"""Normal errors of deviation 1 are within this as often as `COVERAGE` says."""
REFUTED = 3.0
"""Errors of so many times what noise and preview explain together refute the preview's interval."""
NOISE_DRAWS = 16
MIN_MODEL_FRACTION = 0.25
"""Least share of the mean square error of scores that is held against the model, not the noise."""


def fit_spread(
    error: Array, noise: Array, ensemble: Array, brightness: Array
) -> tuple[float, float]:
    """Return ``(b0, b1)`` of the residual's standard deviation ``exp(b0 + b1 z)`` in log T.

    Maximum likelihood of normal errors with the variance ``exp(2 b0 + 2 b1 z) + ensemble +
    noise^2``. Errors beyond the 99.9th percentile are left to the conformal factor. All arguments
    are one-dimensional, one entry per cell.

    ``error`` is out-of-fold ``T_reference / T_prediction - 1``, ``noise`` the reference's standard
    error relative to the prediction, ``ensemble`` the variance among the members and ``brightness``
    the standardized log preview z.
    """
    from scipy.optimize import minimize

    keep = np.abs(error) <= np.quantile(np.abs(error), 0.999)
    square, known, z = error[keep] ** 2, (noise**2 + ensemble)[keep], brightness[keep]

    def loss(b: Array) -> float:
        variance = np.exp(np.clip(2 * (b[0] + b[1] * z), -30.0, 10.0)) + known
        return float(np.mean(np.log(variance) + square / variance))

    # From the median excess: a few cells with very noisy error bars must not set the scale.
    excess = max(float(np.median(square)) / 0.455 - float(np.median(known)), 1e-6)
    start = np.array([0.5 * np.log(excess), 0.0])
    best = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-7}).x
    return float(np.clip(best[0], -10.0, 1.0)), float(np.clip(best[1], -1.0, 1.0))


def counts_spread(
    evaluation: HeldOutEvaluation, transport: Array, deviation: Array, cell_spread: Array
) -> Array:
    """Return one standard deviation of the counts, as the exported graph computes it.

    Arguments:
        evaluation: gives designs, bends and exposure.
        transport: ``(direction, fiber, bend, site, normal)``.
        deviation: deviation of every member from the mean in log T, ``(member, ...)`` the same.
        cell_spread: ``(direction, fiber, bend, site)`` calibrated residual in log T.

    Returns:
        ``(design, bend, site, facet, channel)``.
    """
    light = evaluation.designs.transport(transport[:, :, evaluation.bends, :, :-1])
    alone = light * evaluation.designs.transport(cell_spread[:, :, evaluation.bends])[..., None]
    power = evaluation.designs.power
    variance = np.einsum("dfc,dfbsk->dbskc", power**2, alone**2, optimize=True)
    if len(deviation) > 1:
        for member in deviation[..., :-1]:
            moved = light * evaluation.designs.transport(member[:, :, evaluation.bends])
            together = np.einsum("dfc,dfbsk->dbskc", power, moved, optimize=True)
            variance += together**2 / (len(deviation) - 1)
    return np.asarray(evaluation.exposure * np.sqrt(variance))


@dataclass(frozen=True)
class Comparison:
    """Predictions of held-out designs beside the reference, with what each side may be off by.

    Arguments:
        error, spread, noise: ``(channel,)`` of all lit channels of all facets: error of the
            counts, one standard deviation of the model and of the reference.
        score_error, score_noise: ``(design,)`` error of S, freed of the bias that noise gives the
            reference's S, and standard deviation of the reference's S.
        distinct: number of independent scores that the designs stand for (`independent_number`);
            infinite where designs are off by the model's own errors, as many as its cells.
        noise_share: of the reference (`render.noise_share`).
    """

    error: Array
    spread: Array
    noise: Array
    score_error: Array
    score_noise: Array
    distinct: float = math.inf
    noise_share: float = 0.0

    @property
    def score_spread(self) -> float:
        """One standard deviation of the model's S: what the noise does not explain."""
        total = float(np.mean(self.score_error**2))
        beyond = total - float(np.mean(self.score_noise**2))
        return math.sqrt(max(beyond, MIN_MODEL_FRACTION * total))


def compare(
    evaluation: HeldOutEvaluation, transport: Array, spread: Array, rng: np.random.Generator
) -> Comparison:
    """Return the comparison of a prediction with the reference of ``evaluation``.

    The noise of S comes from a parametric bootstrap: S of the prediction with the reference's
    noise added, against S of the prediction itself. Its mean is the bias (S absorbs noise in its
    spreads), its standard deviation the noise.

    ``transport`` is predicted out of fold, ``(direction, fiber, bend, site, normal)``; ``spread``
    ``(design, bend, site, facet, channel)`` is one standard deviation of the counts.
    """
    guess = evaluation.counts(transport)
    error, lit = guess - evaluation.counts(evaluation.reference), spread > 0
    score = evaluation.scores(guess)
    drawn = []
    for _ in range(NOISE_DRAWS):
        noisy = transport + evaluation.error * evaluation.noise(rng)
        drawn.append(evaluation.scores(evaluation.counts(noisy)) - score)
    bias, deviation = np.mean(drawn, axis=0), np.std(drawn, axis=0, ddof=1)
    return Comparison(
        distinct=independent_number(np.array(drawn)),
        error=error[lit],
        spread=spread[lit],
        noise=evaluation.counts_noise()[lit],
        score_error=score + bias - evaluation.scores(evaluation.counts(evaluation.reference)),
        score_noise=deviation,
    )


def independent_number(drawn: Array) -> float:
    """Return how many independent scores those of many designs stand for, at least 1.

    Designs of few lamps share their light, so that their scores are off together, however many
    designs are tried. The number is the participation ratio ``(tr C)^2 / tr C^2`` of their
    covariance C, infinite where none varies. Of n + 1 Gaussian draws with the sample covariance W,
    ``E (tr W)^2 = (tr C)^2 + 2 tr C^2 / n`` and ``E tr W^2 = (1 + 1/n) tr C^2 + (tr C)^2 / n``,
    solved for both (Chen, Zhang and Zhong 2010); it is the number of draws at most.

    ``drawn`` ``(draw, design)`` are scores with the noise of renders.
    """
    n = len(drawn) - 1
    off = drawn - drawn.mean(axis=0)
    gram = off @ off.T / n
    trace, square = float(np.trace(gram)), float(np.sum(gram**2))
    if trace <= 0.0:
        return math.inf
    # tr C^2 from both expectations, without bias.
    common = n**2 / ((n - 1) * (n + 2)) * (square - trace**2 / n)
    whole = trace**2 - 2.0 * common / n
    return max(1.0, whole / common) if common * len(drawn) > whole else float(len(drawn))


@dataclass(frozen=True)
class Quantiles:
    """Split conformal factors for COVERAGE (Vovk 2005; Lei et al. 2018).

    Arguments:
        counts: a channel of a facet lies within ``counts * counts_spread`` of its prediction.
        score_factor: S lies within ``score_factor * score_spread`` counts of its prediction.
        score_spread: one standard deviation of S, in counts.
        effort: times how many samples the renders must have to say more of scores than was known
            before them; 1 where they do.
    """

    counts: float
    score_factor: float
    score_spread: float
    effort: float = 1.0

    @property
    def score(self) -> float:
        """Half-width of the interval of S, in counts."""
        return self.score_factor * self.score_spread


def conformal(comparison: Comparison, known: float | None = None) -> Quantiles:
    """Return the factors that cover the comparison's designs.

    Errors that other light paths draw anew (of tables) are known by as many as the designs have
    independent scores: the factor is at least that of Student's t with so many degrees, times the
    root mean square, or what is known.

    ``known`` is the half-width of a score's interval before anything was rendered, counts: that of
    the preview, which other sensors calibrated. Renders whose noise reaches as far say nothing of
    the model, nor do those whose noise hides what scores are made of (`render.noise_share`): how
    far it puts scores off is not known, so that they seem to refute any interval. Few scores say
    little. Then it is still what is known. What renders bear out is no worse than the preview
    (`surrogate.training.halves`).
    """
    from scipy.stats import t

    relative = np.abs(comparison.score_error) / np.hypot(
        comparison.score_spread, comparison.score_noise
    )
    found = Quantiles(
        counts=_quantile(np.abs(comparison.error) / np.hypot(comparison.spread, comparison.noise)),
        score_factor=_quantile(relative),
        score_spread=comparison.score_spread,
    )
    noise = float(np.sqrt(np.mean(comparison.score_noise**2)))
    seen = float(np.sqrt(np.mean(comparison.score_error**2)))
    few = 0.0
    if math.isfinite(comparison.distinct):
        few = t.ppf(0.5 + 0.5 * COVERAGE, comparison.distinct) * np.sqrt(np.mean(relative**2))
    if known is not None:
        effort = converging_effort(comparison.noise_share)
        hidden = comparison.noise_share > UNCONVERGED_SHARE
        refuted = seen > REFUTED * math.hypot(noise, known / NORMAL)
        if refuted and not hidden:
            return found
        if hidden or NORMAL * noise >= known:
            # The variance of noise falls with the samples.
            effort = max(effort, (NORMAL * noise / known) ** 2)
            return Quantiles(found.counts, NORMAL, known / NORMAL, effort)
        few = min(few, known / found.score_spread)
    return replace(found, score_factor=float(max(found.score_factor, few)))


@dataclass(frozen=True)
class Coverage:
    """Fractions of channels of facets and of scores that their intervals held."""

    counts: float
    score: float


def coverage(comparison: Comparison, quantiles: Quantiles) -> Coverage:
    """Return how often intervals with ``quantiles`` hold the comparison's reference."""
    half_width = quantiles.counts * np.hypot(comparison.spread, comparison.noise)
    score_half_width = quantiles.score_factor * np.hypot(
        quantiles.score_spread, comparison.score_noise
    )
    return Coverage(
        float(np.mean(np.abs(comparison.error) <= half_width)),
        float(np.mean(np.abs(comparison.score_error) <= score_half_width)),
    )


def _quantile(values: Array) -> float:
    """Return the ceil((n + 1) COVERAGE)-th smallest value: the finite-sample conformal quantile."""
    n = len(values)
    rank = min(n, int(np.ceil((n + 1) * COVERAGE)))
    return float(np.partition(values, rank - 1)[rank - 1])
