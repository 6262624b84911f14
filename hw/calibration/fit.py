"""Fitting material, powers and camera to the reference lines.

Counts at a point of fiber f, channel c, are modeled as

    gain_c * power_f * light(material, f, bend, point) * (1 - v r^2),

with ``light`` of the material table, corrected by the surrogate, read at image positions that a
small tilt of the camera has moved. Powers are relative: their mean is 1, the gains hold the rest.
Only the reduced scattering is fitted: g and sigma_s alone leave the same photographs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from hw.calibration.intervals import StandardErrors, intervals
from hw.calibration.material import HIGH, LOW, NAMES, UNITS, Material
from hw.calibration.material_table import MaterialTable
from hw.calibration.measurement import Measurement
from hw.calibration.model_error import ErrorModes
from hw.calibration.residuals import MATERIAL, TILT, VIGNETTING, CalibrationResiduals
from hw.errors import CalibrationError
from render.arrays import Array

ROUNDS = 2
"""Fits, each weighed by what the one before predicts."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What the fit found.

    Arguments:
        material: best values.
        power: ``(fiber,)`` relative, mean 1; NaN for fibers that were not photographed.
        gain: ``(3,)`` counts per unit radiance and power.
        tilt: ``(3,)`` rad; vignetting: part of light lost at the corners.
        intervals: of all these.
        predicted: list of ``(point, 3)`` counts, one for every measurement.
        chi: rms of residuals in units of their expected errors.
    """

    material: Material
    power: Array
    gain: Array
    tilt: Array
    vignetting: float
    intervals: StandardErrors
    predicted: list[Array]
    chi: float


def calibrate(
    table: MaterialTable,
    log_correction: Array,
    modes: ErrorModes,
    measurements: list[Measurement],
    start: Material,
    roughness: float,
) -> Calibration:
    """Return the best material, powers and gains, with intervals.

    Arguments:
        table: of the scene at the bends of the measurements.
        log_correction: ``(bend, fiber, point)`` added to the table's log light.
        modes: independent log errors that the model may have, fitted with everything else.
        measurements: at least one photograph at each bend.
        start: where the fit starts.
        roughness: what is known of it.

    Raises:
        CalibrationError: too few photographs, or the fit does not converge.
    """
    from scipy.optimize import least_squares

    problem = CalibrationResiduals(table, log_correction, modes, measurements, roughness)
    x = problem.start(start)
    low, high = problem.bounds()
    for _ in range(ROUNDS):
        found = least_squares(
            problem.residuals,
            np.clip(x, low + 1e-6, high - 1e-6),
            jac=problem.jacobian,
            bounds=(low, high),
            x_scale=problem.scale(),
            loss=partial(_robust, problem.rows),
            ftol=1e-8,
            xtol=1e-7,
            max_nfev=200,
        )
        if not found.success or not np.isfinite(found.x).all():
            raise CalibrationError(
                "the fit of the material did not converge: capture again with more light and see "
                "that the scene's lengths are those of the rig",
                field="calibration",
            )
        x = found.x
        problem.expect(x)
    return _result(problem, x)


def _robust(rows: int, squares: Array) -> Array:
    """Return the loss of squared residuals and its two derivatives, ``(3, residual)``.

    Soft l1 for the ``rows`` of the photographs, so that dust counts for little; the amplitudes of
    the model's errors after them are what they are.
    """
    root = np.sqrt(1 + squares)
    loss = np.stack([2 * (root - 1), 1 / root, -0.5 / root**3])
    loss[0, rows:], loss[1, rows:], loss[2, rows:] = squares[rows:], 1.0, 0.0
    return loss


def require_known(found: Calibration) -> None:
    """Refuse a fit that ended where the model is not known.

    Raises:
        CalibrationError: the material lies at the end of its range.
    """
    material, span = found.material.array(), HIGH - LOW
    at_end = (material < LOW + 1e-3 * span) | (material > HIGH - 1e-3 * span)
    # Absorption and roughness may well be as small as can be.
    at_end[1] &= material[1] > HIGH[1] / 2
    at_end[3] &= material[3] > HIGH[3] / 2
    if at_end.any():
        worst = int(np.argmax(at_end))
        name = NAMES[worst].replace("_", " ")
        factor = 180 / np.pi if UNITS[worst] == "deg" else 1.0
        raise CalibrationError(
            f"the photographs ask for a {name} beyond the range that is known, allowed: "
            f"{factor * LOW[worst]:.3g} to {factor * HIGH[worst]:.3g} {UNITS[worst]}; see that the "
            "scene's lengths are those of the rig",
            field=NAMES[worst],
            value=factor * float(material[worst]),
            allowed=f"{factor * LOW[worst]:.3g} to {factor * HIGH[worst]:.3g}",
        )


def _result(problem: CalibrationResiduals, x: Array) -> Calibration:
    power, gain = problem.unpack(x)
    everywhere = np.full(problem.table.coefficients.shape[2], np.nan)
    everywhere[problem.fibers] = power
    whole = np.full(3, np.nan)
    whole[problem.channels] = gain
    residuals = problem.residuals(x)[: problem.rows]
    return Calibration(
        material=Material.from_array(x[MATERIAL]),
        power=everywhere,
        gain=whole,
        tilt=x[TILT],
        vignetting=float(x[VIGNETTING]),
        intervals=intervals(problem, x),
        predicted=problem.predictions(x),
        chi=float(np.sqrt(np.mean(residuals[residuals != 0] ** 2))),
    )
