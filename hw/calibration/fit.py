"""Fitting material, powers and camera to the reference lines.

Counts at a point of fiber f, channel c, are modelled as

    gain_c * power_f * light(material, f, bend, point) * (1 - v r^2),

with ``light`` of the material table, corrected by the surrogate, read at image positions that a
small tilt of the camera has moved. Powers are relative: their mean is 1, the gains hold the rest.
Only the reduced scattering is fitted: g and sigma_s alone leave the same photographs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw.calibration.intervals import Intervals, intervals
from hw.calibration.material import HIGH, LOW, Material
from hw.calibration.material_table import MaterialTable
from hw.calibration.measurement import Measurement
from hw.errors import CalibrationError
from render.bending import Array

MATERIAL = slice(0, 4)
TILT = slice(4, 7)
VIGNETTING = 7
FIXED = 8
"""Number of parameters before the logs of powers and gains."""
SMALLEST_TILT = 1e-3
"""Step of the tilt's derivatives, rad."""


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
    intervals: Intervals
    predicted: list[Array]
    chi: float


def calibrate(
    table: MaterialTable,
    log_correction: Array,
    discrepancy: Array,
    measurements: list[Measurement],
    start: Material,
) -> Calibration:
    """Return the best material, powers and gains, with intervals.

    Arguments:
        table: of the scene at the bends of the measurements.
        log_correction: ``(bend, fiber, point)`` added to the table's log light.
        discrepancy: ``(bend,)`` relative error of the model itself, smooth over the pad.
        measurements: at least one photograph at each bend.
        start: where the fit starts.

    Raises:
        CalibrationError: too few photographs, or the fit ends outside the range of materials.
    """
    from scipy.optimize import least_squares

    problem = _Problem(table, log_correction, discrepancy, measurements)
    begin = problem.start(start)
    low, high = problem.bounds()
    found = least_squares(
        problem.residuals,
        np.clip(begin, low + 1e-6, high - 1e-6),
        bounds=(low, high),
        x_scale=problem.scale(),
        loss="soft_l1",
        max_nfev=200,
    )
    if not found.success or not np.isfinite(found.x).all():
        raise CalibrationError(
            "the fit of the material did not converge: capture again with more light and see that "
            "the scene's lengths are those of the rig",
            field="calibration",
        )
    material = found.x[MATERIAL]
    span = HIGH - LOW
    at_end = (material < LOW + 1e-3 * span) | (material > HIGH - 1e-3 * span)
    # Absorption and roughness may well be as small as can be.
    at_end[1] &= material[1] > HIGH[1] / 2
    at_end[3] &= material[3] > HIGH[3] / 2
    if at_end.any():
        name = ("reduced scattering", "absorption", "sigma_v", "roughness")[int(np.argmax(at_end))]
        raise CalibrationError(
            f"the photographs ask for a {name} beyond the range that is known, allowed: "
            f"{LOW[int(np.argmax(at_end))]:.3g} to {HIGH[int(np.argmax(at_end))]:.3g}; see that "
            "the scene's lengths are those of the rig",
            field=name,
        )
    return problem.result(found.x)


class _Problem:
    """The least-squares problem: parameters to weighted residuals."""

    def __init__(
        self,
        table: MaterialTable,
        log_correction: Array,
        discrepancy: Array,
        measurements: list[Measurement],
    ) -> None:
        self.table, self.correction = table, log_correction
        self.discrepancy, self.measurements = discrepancy, measurements
        self.fibers = sorted({one.fiber for one in measurements})
        self.channels = sorted({c for one in measurements for c in one.channels})
        if len(self.fibers) < 4:
            raise CalibrationError(
                f"{len(self.fibers)} fibers were photographed, allowed: at least 4; capture a "
                "sweep",
                field="measurements",
                value=len(self.fibers),
            )

    @property
    def size(self) -> int:
        return FIXED + len(self.fibers) - 1 + len(self.channels)

    def unpack(self, x: Array) -> tuple[Array, Array]:
        """Return powers ``(fiber,)`` with mean 1 and gains ``(3,)``."""
        free = x[FIXED : FIXED + len(self.fibers) - 1]
        power = np.exp(np.concatenate([[0.0], free]))
        power /= power.mean()
        gain = np.full(3, np.nan)
        gain[self.channels] = np.exp(x[FIXED + len(self.fibers) - 1 :])
        return power, gain

    def start(self, material: Material) -> Array:
        """Return parameters from ``material`` and the overall brightness of each photograph."""
        x = np.zeros(self.size)
        x[MATERIAL] = material.array()
        log_light = self.table.log_light(x[MATERIAL]) + self.correction
        ratio = np.zeros((len(self.measurements), 3)) * np.nan
        for row, one in enumerate(self.measurements):
            light = np.exp(log_light[one.bend, one.fiber])[one.used]
            for channel in one.channels:
                ratio[row, channel] = np.log(np.median(one.counts[one.used, channel] / light))
        gain = np.nanmedian(ratio[:, self.channels], axis=0)
        over = np.nanmean(ratio[:, self.channels] - gain, axis=1)
        power = np.array(
            [
                np.mean([over[i] for i, one in enumerate(self.measurements) if one.fiber == fiber])
                for fiber in self.fibers
            ]
        )
        x[FIXED : FIXED + len(self.fibers) - 1] = power[1:] - power[0]
        x[FIXED + len(self.fibers) - 1 :] = gain + power[0]
        return x

    def bounds(self) -> tuple[Array, Array]:
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        low[MATERIAL], high[MATERIAL] = LOW, HIGH
        low[TILT], high[TILT] = -0.1, 0.1
        low[VIGNETTING], high[VIGNETTING] = -0.5, 0.9
        return low, high

    def scale(self) -> Array:
        scale = np.full(self.size, 0.1)
        scale[MATERIAL] = 0.1 * (HIGH - LOW)
        scale[TILT] = 0.005
        return scale

    def predictions(self, x: Array) -> list[Array]:
        """Return counts ``(point, 3)`` at every measurement's points."""
        power, gain = self.unpack(x)
        log_light = self.table.log_light(x[MATERIAL]) + self.correction
        own = dict(zip(self.fibers, power, strict=True))
        return [
            np.exp(log_light[one.bend, one.fiber])[:, None]
            * own[one.fiber]
            * (1 - x[VIGNETTING] * one.radius2)[:, None]
            * gain
            for one in self.measurements
        ]

    def residuals(self, x: Array) -> Array:
        """Return weighted residuals of all photographs, one after the other."""
        parts = []
        for one, wanted in zip(self.measurements, self.predictions(x), strict=True):
            seen = one.counts + np.einsum("tpc,t->pc", one.tilt_slope, x[TILT])
            error = self.errors(one, wanted)
            difference = ((seen - wanted) / error)[one.used][:, one.channels]
            parts.append(difference.ravel())
        return np.concatenate(parts)

    def errors(self, one: Measurement, wanted: Array) -> Array:
        """Return expected errors: noise, and the model's own in points that stand for many."""
        return np.asarray(np.hypot(one.noise, self.discrepancy[one.bend] * wanted))

    def result(self, x: Array) -> Calibration:
        power, gain = self.unpack(x)
        everywhere = np.full(self.table.coefficients.shape[2], np.nan)
        everywhere[self.fibers] = power
        residuals = self.residuals(x)
        return Calibration(
            material=Material.from_array(x[MATERIAL]),
            power=everywhere,
            gain=gain,
            tilt=x[TILT],
            vignetting=float(x[VIGNETTING]),
            intervals=intervals(self, x),
            predicted=self.predictions(x),
            chi=float(np.sqrt(np.mean(residuals**2))),
        )
