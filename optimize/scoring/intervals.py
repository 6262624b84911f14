"""How many standard errors an interval reaches to either side of its estimate."""

from __future__ import annotations

NORMAL_95 = 1.959964
"""Of a normal error, two-sided: ``Phi^-1(0.975)``."""
NORMAL_90 = 1.644854
"""The same for 90 %: ``Phi^-1(0.95)``."""


def student_factor(replicates: int, confidence: float = 0.95) -> float:
    """Return the factor of Student's t for a standard error from ``replicates`` (1908).

    >>> round(student_factor(4), 3), round(student_factor(1000), 3)
    (3.182, 1.962)
    """
    from scipy.special import stdtrit

    return float(stdtrit(replicates - 1, 0.5 + confidence / 2))
