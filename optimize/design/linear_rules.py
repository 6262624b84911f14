"""Linear rules of a coloring: LEDs of each color, lit lamps, lamps that exclude another, budgets.

Every rule gives each choice of each lamp a weight; what is chosen may weigh so much together. So
searches of all kinds keep to all rules in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optimize.design.design import Array, Colors

SCALE = 10_000
"""Weights of a budget are whole numbers of such parts of its unit, so that sums are exact."""


@dataclass(frozen=True, eq=False)
class Budget:
    """What lit lamps may cost together, in the unit of its ``key`` of the scene file.

    ``cost`` is ``(F, choice)``.
    """

    key: str
    cost: Array
    limit: float


@dataclass(frozen=True, eq=False)
class LinearRules:
    """What is chosen weighs at most ``most`` by every rule.

    Arguments:
        weights: ``(rule, F, choice)`` whole numbers, at least 0.
        most: ``(rule,)``.
    """

    weights: Colors
    most: Colors

    @classmethod
    def of(
        cls,
        led: Colors,
        led_counts: Colors,
        fibers: int,
        dark: int,
        most_lit: int | None,
        exclusive: NDArray[np.bool_] | None,
        budgets: tuple[Budget, ...],
    ) -> LinearRules:
        """Return the rules of `optimize.design.SearchLimits`; rules that forbid nothing are none.

        ``led`` ``(choice,)`` is which of ``led_counts`` each choice takes; ``dark`` is the choice
        that is off, or one beyond the choices.
        """
        choices = len(led)
        weights, most = [], []
        lit = np.arange(choices) != dark
        if most_lit is not None and most_lit < fibers:
            weights.append(np.tile(lit, (fibers, 1)))
            most.append(most_lit)
        for number, count in enumerate(led_counts.tolist()):
            if count < fibers:
                weights.append(np.tile(led == number, (fibers, 1)))
                most.append(count)
        for group in [] if exclusive is None else exclusive_groups(exclusive):
            weights.append(np.isin(np.arange(fibers), group)[:, None] & lit)
            most.append(1)
        for budget in budgets:
            weights.append(np.ceil(np.round(budget.cost * SCALE, 3)))
            most.append(int(budget.limit * SCALE + 1e-3))
        shape = (len(weights), fibers, choices)
        return cls(np.array(weights, dtype=np.int64).reshape(shape), np.array(most, dtype=np.int64))

    def of_groups(self, groups: Colors) -> LinearRules:
        """Return the rules of whole ``groups`` ``(F,)``, 0..G-1, whose lamps choose together."""
        weights = np.zeros((int(groups.max()) + 1, len(self.most), self.weights.shape[2]), np.int64)
        np.add.at(weights, groups, np.moveaxis(self.weights, 1, 0))
        return LinearRules(np.moveaxis(weights, 0, 1), self.most)

    def used(self, chosen: Colors) -> Colors:
        """Return what ``chosen`` ``(N, F)`` weigh by every rule, ``(N, rule)``."""
        sums = [_weighed(rule, chosen) for rule in self.weights]
        return np.stack(sums, axis=1) if sums else np.empty((len(chosen), 0), dtype=np.int64)

    def fit(self, chosen: Colors) -> NDArray[np.bool_]:
        """Return which of ``chosen`` ``(N, F)`` keep to all rules."""
        fits = np.ones(len(chosen), dtype=bool)
        for rule, most in zip(self.weights, self.most, strict=True):
            fits &= _weighed(rule, chosen) <= most
        return fits

    def best_choice(self, worth: Array, allowed: NDArray[np.bool_]) -> Colors | None:
        """Return the choices ``(F,)`` of greatest total ``worth`` ``(F, choice)``; None: no such.

        A mixed-integer program, solved by HiGHS (Huangfu and Hall 2018) to the optimum.
        """
        from scipy.optimize import Bounds, LinearConstraint, milp
        from scipy.sparse import csr_array, eye_array, kron

        fibers, choices = allowed.shape
        one_each = kron(eye_array(fibers), np.ones((1, choices)), format="csr")
        rules = [LinearConstraint(one_each, 1.0, 1.0)]
        if len(self.most):
            weights = csr_array(self.weights.reshape(len(self.most), -1).astype(np.float64))
            rules.append(LinearConstraint(weights, -np.inf, self.most))
        found = milp(
            -np.where(allowed, worth, 0.0).ravel(),
            constraints=rules,
            integrality=np.ones(allowed.size),
            bounds=Bounds(0.0, allowed.ravel().astype(np.float64)),
            options={"mip_rel_gap": 0.0},
        )
        if found.x is None:
            return None
        return np.asarray(found.x.reshape(allowed.shape).argmax(axis=1), dtype=np.int64)


def _weighed(rule: Colors, chosen: Colors) -> Colors:
    """Return what ``chosen`` ``(N, F)`` weigh by one rule ``(F, choice)``, ``(N,)``."""
    lamps = np.flatnonzero(rule.any(axis=1))  # few, where lamps of one place exclude each other
    return np.asarray(rule[lamps, chosen[:, lamps]].sum(axis=1))


def exclusive_groups(exclusive: NDArray[np.bool_]) -> list[list[int]]:
    """Return groups of lamps, of each of which at most one may be lit, that say all of it.

    ``exclusive`` ``(F, F)`` is symmetric. Groups grow as long as every lamp excludes every other.

    >>> pairs = np.zeros((4, 4), dtype=bool)
    >>> pairs[[0, 0, 1, 2], [1, 2, 2, 3]] = True
    >>> exclusive_groups(pairs | pairs.T)
    [[0, 1, 2], [2, 3]]
    """
    left = np.triu(exclusive, 1)
    groups = []
    for first, second in np.argwhere(left).tolist():
        if not left[first, second]:
            continue
        group = [first, second]
        for other in range(len(left)):
            if other not in group and exclusive[other, group].all():
                group.append(other)
        left[np.ix_(group, group)] = False
        groups.append(sorted(group))
    return groups
