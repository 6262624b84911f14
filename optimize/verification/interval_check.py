"""Whether renders bear out the interval that the surrogate states for a score."""

from __future__ import annotations

import math
from typing import Literal

IntervalCheck = Literal["holds", "does not hold", "cannot be tested"]


def check_interval(
    error: float, half_width: float, se: float, coverage: float = 0.9
) -> IntervalCheck:
    """Return what renders say of an interval, in words that end a sentence.

    The surrogate and the renders are both uncertain, so the score may be off by the root of the sum
    of the squares of their half-widths at the same coverage. Renders that are less certain than the
    surrogate would let nearly every interval pass: what they do not refute, they cannot test.

    Example:
        >>> check_interval(1.0, 2.0, 0.1), check_interval(9.0, 2.0, 0.1)
        ('holds', 'does not hold')
        >>> check_interval(1.0, 2.0, 5.0), check_interval(99.0, 2.0, 5.0)
        ('cannot be tested', 'does not hold')

    Arguments:
        error: predicted score minus rendered score.
        half_width: of the surrogate's interval.
        se: standard error of the rendered score.
        coverage: of the surrogate's interval.
    """
    from scipy.special import ndtri

    noise = float(ndtri(0.5 + coverage / 2)) * se
    if abs(error) > math.hypot(half_width, noise):
        return "does not hold"
    return "cannot be tested" if noise > half_width else "holds"
