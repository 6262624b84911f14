"""Which colors the units of an enumeration may have, and how many fibers each color may take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optimize.design.design import Colors
from optimize.design.limits import SearchLimits


@dataclass(frozen=True, eq=False)
class Quota:
    """SearchLimits of colorings, by unit.

    Arguments:
        allowed: ``(U, 3)`` which colors each unit may have.
        fibers: ``(U,)`` fibers of each unit.
        most: ``(3,)`` most fibers per color.
    """

    allowed: NDArray[np.bool_]
    fibers: Colors
    most: Colors

    @classmethod
    def open(cls, units: int) -> Quota:
        """Return the quota that allows everything."""
        one = np.ones(units, dtype=np.int64)
        return cls(np.ones((units, 3), dtype=bool), one, np.full(3, units, dtype=np.int64))

    @classmethod
    def of(cls, limits: SearchLimits, groups: Colors | None = None) -> Quota:
        """Return the quota of ``limits`` for fibers, or for whole ``groups`` ``(F,)``, 0..G-1."""
        fibers = len(limits.allowed)
        member = np.arange(fibers) if groups is None else groups
        count = int(member.max()) + 1
        allowed = np.stack([limits.allowed[member == unit].all(axis=0) for unit in range(count)])
        return cls(allowed, np.bincount(member).astype(np.int64), limits.led_counts)

    @property
    def limited(self) -> bool:
        """Whether anything is forbidden."""
        return bool(not self.allowed.all() or (self.most < self.fibers.sum()).any())

    def codes(self, start: int, stop: int) -> Colors:
        """Return the base-3 codes of all colorings of units ``start`` to ``stop`` that fit."""
        count = stop - start
        codes: Colors = np.arange(3**count, dtype=np.int64)
        if not self.limited or not count:
            return codes
        chosen = digits(codes, count)
        fits = self.allowed[np.arange(start, stop), chosen].all(axis=1)
        fits &= (self.used(codes, start, stop) <= self.most).all(axis=1)
        return codes[fits]

    def used(self, codes: Colors, start: int, stop: int) -> Colors:
        """Return the fibers per color ``(N, 3)`` of ``codes`` over units ``start`` to ``stop``."""
        chosen, weight = digits(codes, stop - start), self.fibers[start:stop]
        return np.stack([((chosen == c) * weight).sum(axis=1) for c in range(3)], axis=1)


def digits(codes: Colors, count: int) -> Colors:
    """Return ``count`` base-3 digits of each code, the first unit's most significant."""
    powers = 3 ** np.arange(count - 1, -1, -1, dtype=np.int64)
    return np.asarray(codes[:, None] // powers % 3, dtype=np.int64)
