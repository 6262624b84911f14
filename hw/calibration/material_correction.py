"""What renders of several materials know better than the preview, for any material between them.

The log ratio of rendered to drawn light is a field in a fiber's frame that changes smoothly with
the material. Both are taken as independent Gaussians in the same linear model (Rasmussen and
Williams 2006, section 2.1): amplitudes of smooth fields (``kernel``, eq. 4.9), times the terms
of the material table's polynomial, shared by all fibers and of each fiber's own, and a free
constant of each fiber in each render, which its power takes up. So all renders of all materials
speak together, and the corrected table is again a polynomial in the material.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from hw.calibration.material_table import EXPONENTS, MaterialTable, terms
from hw.calibration.model_error import ErrorModes, modes_of
from hw.calibration.pad_light import PadLight
from hw.calibration.reference_lines import ReferenceLines, frame_positions
from hw.calibration.smooth_ratio import LogRatios, kernel, ratios
from hw.errors import CalibrationError
from render.arrays import Array

DEGREES = EXPONENTS.sum(axis=1)
SHARED_AMPLITUDES = (0.04, 0.08, 0.16)
FIBER_AMPLITUDES = (0.02, 0.04, 0.08)
DEGREE_DECAYS = (0.2, 0.4)
"""Relative sizes of the shared and the fibers' own fields, and what a degree in the material, half
a range each, takes away; the renders choose."""
OUTLIER_SIGMAS = 4.0
"""Standard errors from the fit beyond which a part of a render is left out."""
MIN_EIGENVALUE = 1e-3
"""Relative variance of fields below which they are left out."""


@dataclass(frozen=True, eq=False)
class MaterialRender:
    """One material, rendered.

    Arguments:
        material: ``(4,)``.
        light: of the fibers that matter at each bend.
    """

    material: Array
    light: PadLight

    def ratios(self, bend: int, fiber: int, position: Array, log_light: Array) -> LogRatios:
        """Return what it says about one fiber at its lines.

        Arguments:
            bend: its index.
            fiber: its number.
            position: ``(point, 2)`` mm on the flat pad.
            log_light: ``(point,)`` of the table, NaN where nothing is wanted.
        """
        radiance, error = self.light.at(bend, fiber, position)
        return ratios(frame_positions(), self.light.part_of(position), radiance, error, log_light)


class _Fields:
    """Smooth fields over the reference lines, each with an amplitude of standard deviation 1."""

    def __init__(self) -> None:
        place = frame_positions()
        size, direction = np.linalg.eigh(kernel(place, place))
        kept = size > MIN_EIGENVALUE * size.max()
        self._known, self._weights = place, direction[:, kept] / np.sqrt(size[kept])
        self.at_lines = self.at(place)
        self.count = int(kept.sum())

    def at(self, place: Array) -> Array:
        """Return the fields ``(n, field)`` at places ``(n, 2)`` mm."""
        return np.asarray(kernel(place, self._known) @ self._weights)


class BendCorrection:
    """What renders say at one bend.

    Arguments:
        data: for each render, for each fiber, what it says.
        materials: ``(render, 4)``.
    """

    def __init__(self, data: Sequence[Sequence[LogRatios]], materials: Array) -> None:
        """Choose sizes by marginal likelihood (eq. 2.30) and solve for the amplitudes."""
        self._fields, self._basis = _Fields(), terms(materials)
        self._gather(data)
        sizes = max(
            itertools.product(SHARED_AMPLITUDES, FIBER_AMPLITUDES, DEGREE_DECAYS),
            key=lambda size: self._solve(*size),
        )
        self._solve(*sizes)
        # A few spikes do not change the sizes.
        self._gather([self._without_spikes(*pair) for pair in zip(self._basis, data, strict=True)])
        self._solve(*sizes)

    def _gather(self, data: Sequence[Sequence[LogRatios]]) -> None:
        self._sums = [self._normal([one[fiber] for one in data]) for fiber in range(len(data[0]))]

    def _without_spikes(self, row: Array, data: Sequence[LogRatios]) -> list[LogRatios]:
        """Return one render's data without what lies far from the fit.

        A path that carries very much light is rare: its part is far too bright, and the smooth
        variance does not know it.
        """
        kept = []
        for one, (_, alone, passed) in zip(data, self._own, strict=True):
            fields = (alone + passed @ self._shared).reshape(len(row), -1)
            away = one.log_ratio - self._fields.at(one.place) @ (row @ fields)
            if len(away):
                away -= np.average(away, weights=1 / one.variance)
            near = np.abs(away) < OUTLIER_SIGMAS * np.sqrt(one.variance)
            kept.append(LogRatios(one.place[near], one.log_ratio[near], one.variance[near]))
        return kept

    def _normal(self, data: Sequence[LogRatios]) -> tuple[Array, Array]:
        """Return the normal equations of one fiber: matrix and right side of its amplitudes."""
        size = len(EXPONENTS) * self._fields.count
        matrix, right = np.zeros((size, size)), np.zeros(size)
        for one, row in zip(data, self._basis, strict=True):
            if len(one.log_ratio) < 2:
                continue
            fields, weight = self._fields.at(one.place), 1 / one.variance
            # A free constant takes the weighted mean away.
            total = weight.sum()
            fields = fields - weight @ fields / total
            values = one.log_ratio - weight @ one.log_ratio / total
            gram = fields.T @ (weight[:, None] * fields)
            matrix += np.kron(np.outer(row, row), gram)
            right += np.kron(row, fields.T @ (weight * values))
        return matrix, right

    def _solve(self, shared: float, own: float, decay: float) -> float:
        """Find the amplitudes for these sizes; return their log likelihood, but a constant."""
        steps = np.repeat(decay ** DEGREES.astype(np.float64), self._fields.count)
        prior, own_prior = 1 / (shared * steps) ** 2, 1 / (own * steps) ** 2
        size = len(prior)
        matrix, right, likelihood = np.diag(prior), np.zeros(size), 0.5 * np.log(prior).sum()
        self._own = []
        for gram, side in self._sums:
            # Each fiber's own amplitudes, solved for and taken out (Schur complement).
            spread, log_root = _inverse(gram + np.diag(own_prior))
            alone = spread @ side
            matrix += np.diag(own_prior) - own_prior[:, None] * spread * own_prior
            right += own_prior * alone
            likelihood += 0.5 * (np.log(own_prior).sum() + side @ alone) - log_root
            self._own.append((spread, alone, spread * own_prior))
        self._spread, log_root = _inverse(matrix)
        self._shared = self._spread @ right
        return float(likelihood + 0.5 * right @ self._shared - log_root)

    def coefficients(self) -> Array:
        """Return what the table's coefficients lack, ``(fiber, term, point)``."""
        found = np.stack([alone + passed @ self._shared for _, alone, passed in self._own])
        return np.asarray(found.reshape(len(found), len(EXPONENTS), -1) @ self._fields.at_lines.T)

    def modes(self, material: Array) -> Array:
        """Return the modes ``(mode, fiber, point)`` of what is still open at ``(4,)`` material."""
        row, count = terms(material[None])[0], self._fields.count
        pick = np.kron(row[None], np.eye(count))
        passed = [pick @ one for _, _, one in self._own]
        all_passed = np.concatenate(passed)
        whole = all_passed @ self._spread @ all_passed.T
        for fiber, (spread, _, _) in enumerate(self._own):
            own = slice(fiber * count, (fiber + 1) * count)
            whole[own, own] += pick @ spread @ pick.T
        lines = self._fields.at_lines
        modes = modes_of(0.5 * (whole + whole.T)).reshape(-1, len(self._own), count)
        return np.asarray(modes @ lines.T)


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


@dataclass(frozen=True, eq=False)
class MaterialCorrection:
    """The corrected table, and how wrong it may still be."""

    table: MaterialTable
    lit: list[list[int]]
    bends: list[BendCorrection | None]

    def modes(self, material: Array) -> ErrorModes:
        """Return log errors that the corrected table may still have at ``(4,)`` material."""
        found = []
        for lit, bend in zip(self.lit, self.bends, strict=True):
            own = np.zeros((0, 0, 0)) if bend is None else bend.modes(material)
            whole = np.zeros((len(own), *self.table.coefficients.shape[2:]))
            if bend is not None:
                whole[:, lit] = own
            found.append(whole)
        return tuple(found)


def material_correction(
    table: MaterialTable,
    renders: Sequence[MaterialRender],
    read: NDArray[np.bool_],
    lines: ReferenceLines,
) -> MaterialCorrection:
    """Return the table as ``renders`` correct it.

    Arguments:
        table: drawn by the preview.
        renders: of materials in its range.
        read: ``(bend, fiber, point)``, which points photographs show: near its outline the pad
            is rendered otherwise than it is drawn, and nothing there is asked for.
        lines: of the scene.
    """
    materials = np.stack([one.material for one in renders])
    drawn = [np.where(read, table.log_light(one), np.nan) for one in materials]
    lit = [np.nonzero(own.any(axis=1))[0].tolist() for own in read]
    coefficients = table.coefficients.copy()
    bends: list[BendCorrection | None] = []
    for bend, fibers in enumerate(lit):
        if not fibers:
            bends.append(None)
            continue
        data = [
            [one.ratios(bend, f, lines.position[f], log_light[bend, f]) for f in fibers]
            for one, log_light in zip(renders, drawn, strict=True)
        ]
        own = BendCorrection(data, materials)
        coefficients[:, bend, fibers] += own.coefficients().swapaxes(0, 1)
        bends.append(own)
    return MaterialCorrection(replace(table, coefficients=coefficients), lit, bends)
