"""The jackknife: bias and error bar of a nonlinear statistic of noisy replicates.

The score S (thesis eq. 4.7) subtracts standard deviations, and noise in the transport widens every
standard deviation: the score of a noisy mean is too low by about a constant over the number of
replicates. The jackknife estimates that constant from the replicates themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optimize.scoring.confidence import student_factor
from render.errors import RenderError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JackknifeEstimate:
    """A statistic with its bias removed to first order.

    Arguments:
        value: bias-corrected statistic.
        plain: the statistic of the plain mean over all replicates.
        se: standard error of ``value``.
        pseudo: ``(replicate,)`` pseudo-values; their mean is ``value`` and their scatter is ``se``.
    """

    value: float
    plain: float
    se: float
    pseudo: Array

    @property
    def replicates(self) -> int:
        """Number of independent replicates."""
        return len(self.pseudo)

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Return the two-sided interval of Student's t with ``replicates - 1`` degrees."""
        half = student_factor(self.replicates, confidence) * self.se
        return self.value - half, self.value + half


def jackknife(statistic: Callable[[Array], float], replicates: Array) -> JackknifeEstimate:
    """Return ``statistic(mean of replicates)`` with bias correction and standard error.

    With R replicates, S the statistic of their mean and S_r the one without replicate r, the
    pseudo-values are ``R S - (R - 1) S_r`` (Quenouille 1956, Tukey 1958). ``replicates`` has shape
    ``(replicate, ...)``, float64. For a difference of two designs rendered with common seeds,
    stack both along one axis and let ``statistic`` subtract: common noise then cancels.

    Raises:
        RenderError: with fewer than two replicates there is no error bar.
    """
    count = len(replicates)
    if count < 2:
        raise RenderError(
            f"{count} independent replicate gives no error bar: use at least 2 seeds", field="seeds"
        )
    plain = statistic(replicates.sum(axis=0) / count)
    without = leave_one_out(statistic, replicates)
    pseudo = count * plain - (count - 1) * without
    se = float(np.sqrt(pseudo.var(ddof=1) / count))
    return JackknifeEstimate(float(pseudo.mean()), float(plain), se, pseudo)


def pooled_estimate(parts: Sequence[JackknifeEstimate]) -> JackknifeEstimate:
    """Return the mean of independent estimates, every replicate with the same weight."""
    pseudo = np.concatenate([part.pseudo for part in parts])
    plain = sum(part.plain * part.replicates for part in parts) / len(pseudo)
    se = float(np.sqrt(pseudo.var(ddof=1) / len(pseudo)))
    return JackknifeEstimate(float(pseudo.mean()), float(plain), se, pseudo)


def jackknife_se(statistic: Callable[[Array], Array], replicates: Array) -> Array:
    """Return the standard error of a statistic with axes, ``statistic(mean of replicates)``."""
    without = leave_one_out(statistic, replicates)
    return np.asarray(np.sqrt((len(replicates) - 1) * without.var(axis=0)))


def leave_one_out(
    statistic: Callable[[Array], Array] | Callable[[Array], float], replicates: Array
) -> Array:
    """Return ``statistic`` of the means without one replicate, ``(replicate, ...)``."""
    total, count = replicates.sum(axis=0), len(replicates)
    return np.array([statistic((total - one) / (count - 1)) for one in replicates])
