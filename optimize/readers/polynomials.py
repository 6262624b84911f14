"""Monomials of several variables up to a degree, and their derivatives as matrices."""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np

from optimize.design import Array


@lru_cache
def _exponents(variables: int, degree: int) -> tuple[tuple[int, ...], ...]:
    """Return the exponents of each monomial, the constant first."""
    found = []
    for order in range(degree + 1):
        for chosen in combinations_with_replacement(range(variables), order):
            found.append(tuple(chosen.count(variable) for variable in range(variables)))
    return tuple(found)


def monomials(x: Array, degree: int) -> Array:
    """Return all monomials ``(..., F)`` of ``x`` ``(..., n)`` up to ``degree``."""
    exponents = _exponents(x.shape[-1], degree)
    number = {entry: index for index, entry in enumerate(exponents)}
    terms = np.empty((*x.shape[:-1], len(exponents)))
    terms[..., 0] = 1.0
    for index, entry in enumerate(exponents[1:], start=1):
        variable = next(v for v, power in enumerate(entry) if power)
        lower = tuple(power - (v == variable) for v, power in enumerate(entry))
        terms[..., index] = terms[..., number[lower]] * x[..., variable]
    return terms


@lru_cache
def derivatives(variables: int, degree: int) -> Array:
    """Return matrices ``(n, F, F)``: monomials times the v-th are derivatives by variable v."""
    exponents = _exponents(variables, degree)
    number = {entry: index for index, entry in enumerate(exponents)}
    matrices = np.zeros((variables, len(exponents), len(exponents)))
    for index, entry in enumerate(exponents):
        for variable, power in enumerate(entry):
            if power:
                lower = tuple(p - (v == variable) for v, p in enumerate(entry))
                matrices[variable, number[lower], index] = power
    matrices.flags.writeable = False
    return matrices
