"""The jackknife: bias and error bar of a nonlinear statistic of noisy replicates.

The score S (thesis eq. 4.7) subtracts standard deviations, and noise in the transport widens every
standard deviation: the score of a noisy mean is too low by about a constant over the number of
replicates. Halves of the replicates have twice that bias, so what they differ by from the whole is
an estimate of it (Shao and Wu 1989: statistics that are not smooth, as S is where neighboring
facets have nearly one hue, need such large groups left out; one replicate left out doubled the
error there). Where noise is as large as what it hides, the bias falls more slowly than with the
number of replicates. Quarters of them tell how slowly, and what that changes is an error of its own
beside that of sampling. S is a sum of terms with biases of both signs that fall at different rates
(noise lifts the mean of steps of hue like its variance, and their spread like its deviation), so
that halves may score like the whole where both are far off: the error of the correction is found
term by term, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optimize.scoring.confidence import student_factor
from render.errors import RenderError
from render.leave_one_out import leave_one_out

Array = NDArray[np.float64]


SUBSETS = 48
"""Halves, and quarters, of the replicates at least: each replicate is in equally many."""
SLOWEST = math.sqrt(2.0)
"""By which the bias falls at least where replicates double: that of an absolute value at 0."""


@dataclass(frozen=True)
class JackknifeEstimate:
    """A statistic freed of the bias that noise gives it.

    Arguments:
        value: bias-corrected statistic.
        plain: the statistic of the plain mean over all replicates.
        pseudo: ``(replicate,)`` pseudo-values; their scatter is ``sampling``.
        bias_error: by which the correction may be off, with a chance of about 90 %.
    """

    value: float
    plain: float
    pseudo: Array
    bias_error: float = 0.0

    @property
    def replicates(self) -> int:
        """Number of independent replicates."""
        return len(self.pseudo)

    @property
    def sampling(self) -> float:
        """Standard error by the noise of replicates alone (Tukey 1958)."""
        return float(np.sqrt(self.pseudo.var(ddof=1) / self.replicates))

    @property
    def se(self) -> float:
        """Standard error of ``value``: `sampling`, and the half of a 90 % interval by the bias."""
        return math.hypot(self.sampling, self.bias_error / student_factor(self.replicates, 0.9))

    def shown(self, sign: str = "") -> str:
        """Return value and standard error as people read them; ``sign`` "+" for differences."""
        return f"{self.value:{sign}.2f} ± {self.se:.2f}"

    def __neg__(self) -> JackknifeEstimate:
        """Return the estimate of minus the statistic."""
        return JackknifeEstimate(-self.value, -self.plain, -self.pseudo, self.bias_error)

    def __sub__(self, other: JackknifeEstimate) -> JackknifeEstimate:
        """Return the difference to an independent estimate of as many replicates."""
        return JackknifeEstimate(
            self.value - other.value,
            self.plain - other.plain,
            self.pseudo - other.pseudo,
            math.hypot(self.bias_error, other.bias_error),
        )

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Return the two-sided interval of Student's t with ``replicates - 1`` degrees."""
        half = student_factor(self.replicates, confidence) * self.se
        return self.value - half, self.value + half


def jackknife(statistic: Callable[[Array], float | Array], replicates: Array) -> JackknifeEstimate:
    """Return ``statistic(mean of replicates)`` with bias correction and error bar.

    A statistic of several terms is their sum. ``replicates`` has shape ``(replicate, ...)``,
    float64. With R replicates and S the statistic of their mean, the bias is S minus the mean of S
    over halves of the replicates, the sampling error that of the pseudo-values
    ``R S - (R - 1) S_r``, S_r without replicate r (Quenouille 1956, Tukey 1958). For a difference
    of two designs rendered with common seeds, stack both along one axis and let ``statistic``
    subtract: common noise then cancels.

    Raises:
        RenderError: with fewer than two replicates there is no error bar.
    """
    (found,) = jackknife_parts(lambda mean: np.atleast_2d(statistic(mean)), replicates)
    return found


def jackknife_parts(
    statistics: Callable[[Array], Array], replicates: Array
) -> list[JackknifeEstimate]:
    """Return what `jackknife` does of each of some ``statistics``, a function to ``(part, term)``.

    A part is the sum of its terms.
    """
    count = len(replicates)
    if count < 2:
        raise RenderError(
            f"{count} independent replicate gives no error bar: use at least 2 seeds", field="seeds"
        )
    half = max(count // 2, 1)
    plain = statistics(replicates.sum(axis=0) / count)
    without = leave_one_out(statistics, replicates).sum(axis=-1)
    pseudo = count * plain.sum(axis=-1) - (count - 1) * without
    halves = _mean_over_subsets(statistics, replicates, half)
    quarters = _mean_over_subsets(statistics, replicates, max(half // 2, 1))
    # S of n replicates is off by b / n: what it gains from a half to the whole is left to gain.
    corrections = (plain - halves) / (count / half - 1)
    before = halves - quarters
    return [
        _estimate(part, left, earlier, values)
        for part, left, earlier, values in zip(plain, corrections, before, pseudo.T, strict=True)
    ]


def _estimate(plain: Array, corrections: Array, before: Array, pseudo: Array) -> JackknifeEstimate:
    """Return the estimate of a sum of terms, from ``(term,)`` values and what halves gained.

    Its bias error is that of the sum, and of its terms in quadrature where that is more: what is
    left of biases of one sign adds up in the sum, what cancels shows in the terms alone.
    """
    error = abs(float(corrections.sum()))
    if len(pseudo) >= 4:
        terms = [_bias_error(*pair) for pair in zip(corrections, before, strict=True)]
        error = max(_bias_error(corrections.sum(), before.sum()), math.hypot(*terms))
    whole = float(plain.sum())
    value = whole + float(corrections.sum())
    return JackknifeEstimate(value, whole, pseudo, error)


def _mean_over_subsets(statistics: Callable[[Array], Array], replicates: Array, size: int) -> Array:
    """Return the mean of ``statistics`` over means of ``size`` replicates, each equally often."""
    rng, count = np.random.default_rng(0), len(replicates)
    orders = [np.tile(rng.permutation(count), 2) for _ in range(-(-SUBSETS // count))]
    found = []
    for order in orders:
        total = replicates[order[:size]].sum(axis=0)
        for leaves, enters in zip(order[:count], order[size : size + count], strict=True):
            found.append(statistics(total / size))
            total = total + (replicates[enters] - replicates[leaves])
    return np.asarray(np.mean(found, axis=0))


def _bias_error(correction: float, before: float) -> float:
    """Return the error of ``correction``, what S gains from halves to the whole.

    From quarters to halves it gained ``before``, twice as much where bias falls with the number of
    replicates. Where it is less, more of the bias is left, by the geometric series of that ratio.
    Half of the correction is its least error.
    """
    ratio = min(max(before / correction, SLOWEST), 2.0) if correction else 2.0
    return float(abs(correction) * (1 / (ratio - 1) - 0.5))


def pooled_estimate(parts: Sequence[JackknifeEstimate]) -> JackknifeEstimate:
    """Return the mean of independent estimates, every replicate with the same weight.

    Errors of their corrections have one cause and do not average out.
    """
    pseudo = np.concatenate([part.pseudo for part in parts])
    value, plain, error = (
        sum(getattr(part, name) * part.replicates for part in parts) / len(pseudo)
        for name in ("value", "plain", "bias_error")
    )
    return JackknifeEstimate(value, plain, pseudo, error)
