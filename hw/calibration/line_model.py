"""What photographs are compared with: drawn light at the lines, corrected by the surrogate.

The preview draws whole photographs for any material, but is too dim for grazing light on a bent
pad; the surrogate was fitted to renders, but knows the sites of one material only. The ratio of
both on the untouched pad, for the surrogate's own material, is a smooth field: its logarithm is
taken as a polynomial of the second degree over the pad, and as independent of the material.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw.calibration.log_ratio import ErrorModes, field_modes, quadratic_terms
from hw.calibration.material import MaterialSpace
from hw.calibration.material_table import MaterialTable, material_table
from hw.calibration.reference_lines import Setup
from render.arrays import Array
from render.geometry import flat_sites
from render.preview import cache_folder
from render.progress import OnProgress
from tactilux import Checker, Preview

DISCREPANCY = 0.015
"""Relative error of the corrected preview where the surrogate says nothing about it."""


@dataclass(frozen=True, eq=False)
class SurrogateCorrection:
    """Log of light of the surrogate over that of the preview.

    Where light depends on the camera's channel, all have one more axis ``channel``, the last.

    Arguments:
        coefficients: ``(bend, fiber, term)``.
        corners: ``(2, 2)`` lowest and highest flat x, y (mm) of the sites; beyond, the edge's value
            holds.
        rms: ``(bend,)`` of log ratios at the sites that the polynomial leaves.
    """

    coefficients: Array
    corners: Array
    rms: Array

    def log_ratio(self, position: Array) -> Array:
        """Return log ratios ``(bend, fiber, n[, channel])``.

        Flat positions ``(fiber or 1, n, 2)`` are mm.
        """
        inside = np.clip(np.nan_to_num(position), *self.corners)
        terms = quadratic_terms(inside)
        terms = np.broadcast_to(terms, (self.coefficients.shape[1], *terms.shape[1:]))
        return np.asarray(np.einsum("fnt,bft...->bfn...", terms, self.coefficients))


def surrogate_correction(setup: Setup, checker: Checker) -> SurrogateCorrection:
    """Return the correction for a ``setup`` made of the material that ``checker`` knows."""
    # All fibers at all directions: the diagonal is what is wanted.
    phi, nodes = setup.phi, np.unique(setup.phi)
    table = checker.transport_table(nodes, setup.bends)
    assert table.background is not None
    known = table.background[np.arange(len(phi)), np.searchsorted(nodes, phi)]
    with Preview(setup.scene) as preview:
        drawn = preview.transport(phi[:, None], setup.bends)[1][:, 0]
    ratio = np.log(known / drawn).swapaxes(0, 1)
    sites = flat_sites(setup.scene)[:, :2]
    terms = quadratic_terms(sites)
    coefficients = np.einsum("bfs...,ts->bft...", ratio, np.linalg.pinv(terms))
    residual = ratio - np.einsum("bft...,st->bfs...", coefficients, terms)
    corners = np.stack([sites.min(axis=0), sites.max(axis=0)])
    return SurrogateCorrection(coefficients, corners, np.sqrt((residual**2).mean(axis=(1, 2))))


@dataclass(frozen=True, eq=False)
class LineModel:
    """Light at the reference lines for any material.

    The ``table`` is as the preview draws it or renders correct it; ``log_correction`` ``(bend,
    fiber, point)`` is added to its logarithm, and ``modes`` are log errors that it may still have.
    Where channels have materials of their own, the last two may have one more axis ``channel``, the
    last.

    ``space`` is of the rig's material, that of the ``table`` of one channel's.
    """

    space: MaterialSpace
    table: MaterialTable
    log_correction: Array
    modes: ErrorModes

    def log_light(self, material: Array) -> Array:
        """Return log radiance per unit power, ``(bend, fiber, point[, channel])``, of a rig.

        There are channels where they have materials of their own.
        """
        seen = self.space.seen(material)
        if seen.ndim == 1:
            return self.table.log_light(seen) + self.log_correction
        each = np.stack([self.table.log_light(one) for one in seen], axis=-1)
        return each + with_channels(self.log_correction, 3)


def with_channels(field: Array, axes: int) -> Array:
    """Return ``field`` of that many axes, with one more for channels where it has none yet."""
    return field if field.ndim > axes else field[..., None]


CHANNEL_ERROR = 0.01
"""Relative error of the shape of light that a channel has for itself, beside what all share: more
than renders of several albedos from the same random numbers ask for (0.0025), as the noise of real
photographs and renders is not the same in all channels."""


def error_modes(size: Array, fibers: int, channels: int) -> ErrorModes:
    """Return the modes of smooth errors of relative ``size`` ``(bend,)`` that a model may have.

    Where there are several ``channels``, `CHANNEL_ERROR` of it is each one's own.
    """
    shared = field_modes(size, fibers)
    if not channels:
        return shared
    own = field_modes(np.full(len(size), CHANNEL_ERROR), fibers)
    return tuple(
        np.concatenate(
            [
                np.repeat(common[..., None], channels, axis=-1),
                *(alone[..., None] * only for only in np.eye(channels)),
            ]
        )
        for common, alone in zip(shared, own, strict=True)
    )


def line_model(setup: Setup, checker: Checker, progress: OnProgress | None = None) -> LineModel:
    """Return the model of the reference lines.

    The table is drawn when it is first needed, which takes minutes, and kept in the user's cache.

    ``setup`` is made of the surrogate's own material; ``progress`` is told of every material.
    """
    table = material_table(setup.one_albedo, folder=cache_folder(), progress=progress)
    correction = surrogate_correction(setup, checker)
    left = with_channels(correction.rms, 1).max(axis=-1)
    error = np.hypot(np.hypot(DISCREPANCY, left), table.scatter())
    log_correction = correction.log_ratio(setup.lines.position)
    modes = error_modes(error, len(setup.phi), len(setup.space.of_channel))
    return LineModel(setup.space, table, log_correction, modes)
