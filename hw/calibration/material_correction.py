"""What renders of several materials know better than the preview, for any material between them.

The log ratio of rendered to drawn light is a field in a fiber's frame that changes smoothly with
the material. Both are taken as independent Gaussians in the same linear model (Rasmussen and
Williams 2006, section 2.1): amplitudes of smooth fields (`hw.calibration.log_ratio.kernel`),
times the terms of the material table's polynomial, shared by all fibers and of each fiber's own,
and a free constant of each fiber in each render, which its power takes up. So all renders of all
materials speak together, and the corrected table is again a polynomial in the material.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, lapack

from hw.calibration.log_ratio import ErrorModes, LogRatios, kernel, modes_of
from hw.calibration.material import MaterialSpace
from hw.calibration.material_table import MaterialTable
from hw.calibration.pad_light import MaterialRender
from hw.calibration.reference_lines import ReferenceLines, frame_positions
from hw.errors import CalibrationError
from render.arrays import Array

SHARED_AMPLITUDES = (0.04, 0.08, 0.16)
FIBER_AMPLITUDES = (0.02, 0.04, 0.08)
DEGREE_FACTORS = (0.2, 0.4)
"""Prior standard deviations of the shared and the fibers' own fields, relative, and the factor on
them of each degree in the material, half a range each; the renders choose."""
OUTLIER = 4.0
"""Standard errors from the fit beyond which a part of a render is left out."""
MIN_EIGENVALUE = 1e-3
"""Relative variance of fields below which they are left out."""


class BendCorrection:
    """What renders say at one bend.

    Amplitudes are those of fields times terms of the material: shared by all fibers, and the own
    ones of each, which are solved for given the shared and taken out (Schur complement).

    ``data`` is what each render says of each fiber; ``materials`` of ``space`` are ``(render,
    quantity)``.
    """

    def __init__(
        self, data: Sequence[Sequence[LogRatios]], materials: Array, space: MaterialSpace
    ) -> None:
        """Choose sizes by marginal likelihood (eq. 2.30) and solve for the amplitudes."""
        self._space = space
        self._basis, self._at_lines = space.terms(materials), _fields(frame_positions())
        self._count = self._at_lines.shape[1]
        self._gather(data)
        sizes = max(
            itertools.product(SHARED_AMPLITUDES, FIBER_AMPLITUDES, DEGREE_FACTORS),
            key=lambda size: self._solve(*size),
        )
        self._solve(*sizes)
        # A few spikes do not change the sizes.
        self._gather([self._without_spikes(*pair) for pair in zip(self._basis, data, strict=True)])
        self._solve(*sizes)

    def _gather(self, data: Sequence[Sequence[LogRatios]]) -> None:
        self._sums = [self._normal(of_fiber) for of_fiber in zip(*data, strict=True)]

    def _without_spikes(self, row: Array, data: Sequence[LogRatios]) -> list[LogRatios]:
        """Return one render's data without what lies far from the fit.

        A path that carries very much light is rare: its part is far too bright, and the smooth
        variance does not know it.
        """
        kept = []
        for ratios, (_, alone, passed) in zip(data, self._fibers, strict=True):
            amplitudes = (alone + passed @ self._shared).reshape(len(row), -1)
            residual = ratios.log_ratio - _fields(ratios.place) @ (row @ amplitudes)
            if len(residual):
                residual -= np.average(residual, weights=1 / ratios.variance)
            kept.append(ratios.at(np.abs(residual) < OUTLIER * np.sqrt(ratios.variance)))
        return kept

    def _normal(self, data: Sequence[LogRatios]) -> tuple[Array, Array]:
        """Return the normal equations of one fiber: matrix and right side of its amplitudes."""
        size = self._basis.shape[1] * self._count
        matrix, right = np.zeros((size, size)), np.zeros(size)
        for ratios, row in zip(data, self._basis, strict=True):
            if len(ratios.log_ratio) < 2:
                continue
            fields, weight = _fields(ratios.place), 1 / ratios.variance
            # A free constant takes the weighted mean away.
            total = weight.sum()
            fields = fields - weight @ fields / total
            values = ratios.log_ratio - weight @ ratios.log_ratio / total
            matrix += np.kron(np.outer(row, row), fields.T @ (weight[:, None] * fields))
            right += np.kron(row, fields.T @ (weight * values))
        return matrix, right

    def _solve(self, shared: float, own: float, degree_factor: float) -> float:
        """Find the amplitudes for these sizes; return their log likelihood, but a constant."""
        degrees = self._space.exponents.sum(axis=1)
        steps = np.repeat(float(degree_factor) ** degrees, self._count)
        # Inverse variances of the amplitudes.
        prior, own_prior = 1 / (shared * steps) ** 2, 1 / (own * steps) ** 2
        size = len(prior)
        matrix, right, likelihood = np.diag(prior), np.zeros(size), 0.5 * np.log(prior).sum()
        # Of each fiber: posterior covariance given the shared amplitudes, amplitudes where these
        # are 0, and their change with them.
        self._fibers = []
        for gram, side in self._sums:
            covariance, log_root = _inverse(gram + np.diag(own_prior))
            alone = covariance @ side
            matrix += np.diag(own_prior) - own_prior[:, None] * covariance * own_prior
            right += own_prior * alone
            likelihood += 0.5 * (np.log(own_prior).sum() + side @ alone) - log_root
            self._fibers.append((covariance, alone, covariance * own_prior))
        self._covariance, log_root = _inverse(matrix)
        self._shared = self._covariance @ right
        return float(likelihood + 0.5 * right @ self._shared - log_root)

    def coefficients(self) -> Array:
        """Return what the table's coefficients lack, ``(fiber, term, point)``."""
        amplitudes = np.stack([alone + passed @ self._shared for _, alone, passed in self._fibers])
        by_term = amplitudes.reshape(len(amplitudes), self._basis.shape[1], -1)
        return np.asarray(by_term @ self._at_lines.T)

    def modes(self, materials: Array) -> Array:
        """Return the modes ``(mode, fiber, point[, channel])`` of what is still open.

        At one of ``materials`` ``(quantity,)``, or at those of all channels ``(channel, quantity)``
        together: what is open at one is so at the others too.
        """
        fibers, count = len(self._fibers), self._count
        pick = np.kron(self._space.terms(np.atleast_2d(materials)), np.eye(count))
        all_passed = np.concatenate([pick @ passed for _, _, passed in self._fibers])
        own = [pick @ covariance @ pick.T for covariance, _, _ in self._fibers]
        whole = all_passed @ self._covariance @ all_passed.T + block_diag(*own)
        modes = modes_of(0.5 * (whole + whole.T)).reshape(-1, fibers, *materials.shape[:-1], count)
        found = np.asarray(modes @ self._at_lines.T)
        return found if materials.ndim == 1 else found.swapaxes(-1, -2)


def _fields(place: Array) -> Array:
    """Return smooth fields ``(n, field)`` at places ``(n, 2)`` mm in a fiber's frame.

    Each is to have an amplitude of standard deviation 1.
    """
    lines, weights = _field_weights()
    return np.asarray(kernel(place, lines) @ weights)


@cache
def _field_weights() -> tuple[Array, Array]:
    """Return the points of the lines, and weights ``(point, field)`` of their kernels."""
    lines = frame_positions()
    variance, direction = np.linalg.eigh(kernel(lines, lines))
    kept = variance > MIN_EIGENVALUE * variance.max()
    return lines, direction[:, kept] / np.sqrt(variance[kept])


def _inverse(matrix: Array) -> tuple[Array, float]:
    """Return the inverse of a positive definite matrix, and half the log of its determinant."""
    root, wrong = lapack.dpotrf(matrix, lower=1)
    if wrong:
        raise CalibrationError(
            "what the renders say cannot be solved for: some of their values are not finite; "
            "delete the kept renders, and they are made again",
            field="renders",
        )
    inverse, _ = lapack.dpotri(root, lower=1)
    lower = np.tril(inverse)
    return lower + np.tril(lower, -1).T, float(np.log(np.diag(root)).sum())


class MaterialCorrection:
    """A table as renders correct it, ``table``, and how wrong it may still be.

    Arguments:
        table: drawn by the preview.
        renders: of materials in its range.
        read: ``(bend, fiber, point)``, which points photographs show: near its outline the pad
            is rendered otherwise than it is drawn, and nothing there is asked for.
        lines: of the scene.
    """

    def __init__(
        self,
        table: MaterialTable,
        renders: Sequence[MaterialRender],
        read: NDArray[np.bool_],
        lines: ReferenceLines,
    ) -> None:
        """Correct the fibers that photographs show, bend by bend."""
        materials = np.stack([render.material for render in renders])
        drawn = [np.where(read, table.log_light(material), np.nan) for material in materials]
        coefficients = table.coefficients.copy()
        self._bends: list[tuple[list[int], BendCorrection | None]] = []
        for bend, points in enumerate(read):
            lit, correction = np.nonzero(points.any(axis=1))[0].tolist(), None
            if lit:
                data = [
                    [
                        light.log_ratios(bend, fiber, lines.position[fiber], log_light[bend, fiber])
                        for fiber in lit
                    ]
                    for (_, light), log_light in zip(renders, drawn, strict=True)
                ]
                correction = BendCorrection(data, materials, table.space)
                coefficients[:, bend, lit] += correction.coefficients().swapaxes(0, 1)
            self._bends.append((lit, correction))
        self.table = replace(table, coefficients=coefficients)

    def modes(self, materials: Array) -> ErrorModes:
        """Return log errors that the corrected table may still have.

        At one of ``materials`` ``(quantity,)`` or at those of all channels ``(channel, quantity)``.
        """
        shape, modes = (*self.table.coefficients.shape[2:], *materials.shape[:-1]), []
        for lit, correction in self._bends:
            of_lit = (
                np.zeros((0, 0, *shape[1:])) if correction is None else correction.modes(materials)
            )
            modes.append(np.zeros((len(of_lit), *shape)))
            modes[-1][:, lit] = of_lit
        return tuple(modes)
