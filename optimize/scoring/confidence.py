"""How far intervals reach to either side of an estimate, and whether renders bear one out."""

from __future__ import annotations

import math
from typing import Literal

IntervalCheck = Literal["holds", "does not hold", "cannot be tested"]


def normal_factor(confidence: float = 0.95) -> float:
    """Return how many standard errors a normal error's two-sided interval reaches.

    >>> round(normal_factor(), 3), round(normal_factor(0.9), 3)
    (1.96, 1.645)
    """
    from scipy.special import ndtri

    return float(ndtri(0.5 + confidence / 2))


def student_factor(replicates: int, confidence: float = 0.95) -> float:
    """Return the same for a standard error that comes from ``replicates`` (Student 1908).

    >>> round(student_factor(4), 3), round(student_factor(1000), 3)
    (3.182, 1.962)
    """
    from scipy.special import stdtrit

    return float(stdtrit(replicates - 1, 0.5 + confidence / 2))


def check_interval(
    error: float, half_width: float, se: float, coverage: float = 0.9, *, converged: bool = True
) -> IntervalCheck:
    """Return what renders say of an interval, in words that end a sentence.

    The surrogate and the renders are both uncertain, so the score may be off by the root of the sum
    of the squares of their half-widths at the same coverage. Renders that are less certain than the
    surrogate would let nearly every interval pass: what they do not refute, they cannot test.
    Where renders have not converged, their standard error is not known either, and they test none.

    Example:
        >>> check_interval(1.0, 2.0, 0.1), check_interval(9.0, 2.0, 0.1)
        ('holds', 'does not hold')
        >>> check_interval(1.0, 2.0, 5.0), check_interval(99.0, 2.0, 5.0)
        ('cannot be tested', 'does not hold')
        >>> check_interval(99.0, 2.0, 5.0, converged=False)
        'cannot be tested'

    Arguments:
        error: predicted score minus rendered score.
        half_width: of the surrogate's interval.
        se: standard error of the rendered score.
        coverage: of the surrogate's interval.
        converged: whether the renders have.
    """
    if not converged:
        return "cannot be tested"
    noise = normal_factor(coverage) * se
    if abs(error) > math.hypot(half_width, noise):
        return "does not hold"
    return "cannot be tested" if noise > half_width else "holds"


def prediction_checked(
    error: float, half_width: float, se: float, coverage: float = 0.9, *, converged: bool = True
) -> str:
    """Return what `check_interval` finds, with every number that it rests on, for a sentence.

    Example:
        >>> prediction_checked(10.29, 0.82, 9.5)
        'off by +10.29 (renders ±9.50): its 90% interval of ±0.82 cannot be tested'
    """
    found = check_interval(error, half_width, se, coverage, converged=converged)
    return (
        f"off by {error:+.2f} (renders ±{se:.2f}): its {coverage:.0%} interval of "
        f"±{half_width:.2f} {found}"
    )
