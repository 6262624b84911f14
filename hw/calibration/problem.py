"""The calibration as a least-squares problem: parameters to weighted residuals, and derivatives.

Parameters: material (4), tilt (3, rad), vignetting, the logs of all powers but the first (then
scaled to mean 1), the logs of the gains. The data are one row per used point of a photograph and
one column per channel.
"""

from __future__ import annotations

import numpy as np

from hw.calibration.material import HIGH, LOW, Material
from hw.calibration.material_table import MaterialTable, terms, terms_slope
from hw.calibration.measurement import Measurement
from hw.errors import CalibrationError
from render.bending import Array

MATERIAL, TILT, VIGNETTING, FIXED = slice(0, 4), slice(4, 7), 7, 8


class Problem:
    """The data, ready for any parameters.

    Arguments:
        table: light at the reference lines for any material.
        log_correction: ``(bend, fiber, point)`` added to its logarithm.
        discrepancy: ``(bend,)`` relative error of the model.
        measurements: the photographs.
        draws: ``(draw, bend, fiber, point)`` log errors that the model may have after a correction
            by renders; None where there was none.
    """

    def __init__(
        self,
        table: MaterialTable,
        log_correction: Array,
        discrepancy: Array,
        measurements: list[Measurement],
        draws: Array | None = None,
    ) -> None:
        """Gather the used points of all photographs."""
        self.table, self.correction, self.draws = table, log_correction, draws
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
        used = [one.used for one in measurements]
        self.edges = np.cumsum([0, *(points.sum() for points in used)])
        pairs = list(zip(measurements, used, strict=True))
        self._coefficients = self.gathered(table.coefficients)
        self._base = self.gathered(log_correction[None])[0]
        self._own = np.concatenate(
            [np.full(points.sum(), self.fibers.index(one.fiber)) for one, points in pairs]
        )
        self._radius2 = np.concatenate([one.radius2[points] for one, points in pairs])
        self._counts = np.concatenate(
            [one.counts[points][:, self.channels] for one, points in pairs]
        )
        self._slope = np.concatenate(
            [one.tilt_slope[:, points][:, :, self.channels] for one, points in pairs], axis=1
        )
        self._weight = np.concatenate([self._weights(one)[points] for one, points in pairs])

    def gathered(self, values: Array) -> Array:
        """Return ``(n, bend, fiber, point)`` at the rows, ``(n, row)``."""
        return np.concatenate(
            [values[:, one.bend, one.fiber, one.used] for one in self.measurements], axis=1
        )

    def start(self, material: Material) -> Array:
        """Return parameters from ``material`` and the overall brightness of each photograph."""
        x = np.zeros(FIXED + len(self.fibers) - 1 + len(self.channels))
        x[MATERIAL] = material.array()
        log_light = terms(x[None, MATERIAL])[0] @ self._coefficients + self._base
        ratio = np.log(np.maximum(self._counts, 1e-3)) - log_light[:, None]
        ratio = np.where(self._weight > 0, ratio, np.nan)
        gain = np.nanmedian(ratio, axis=0)
        over = np.nanmean(ratio - gain, axis=1)
        power = np.array([np.median(over[self._own == own]) for own in range(len(self.fibers))])
        x[FIXED : FIXED + len(power) - 1] = power[1:] - power[0]
        x[FIXED + len(power) - 1 :] = gain + np.log(np.mean(np.exp(power)))
        return x

    def bounds(self) -> tuple[Array, Array]:
        """Return lowest and highest parameters."""
        size = FIXED + len(self.fibers) - 1 + len(self.channels)
        low, high = np.full(size, -np.inf), np.full(size, np.inf)
        low[MATERIAL], high[MATERIAL] = LOW, HIGH
        low[TILT], high[TILT] = -0.1, 0.1
        low[VIGNETTING], high[VIGNETTING] = -0.5, 0.9
        return low, high

    def scale(self) -> Array:
        """Return typical sizes of changes of the parameters."""
        scale = np.full(FIXED + len(self.fibers) - 1 + len(self.channels), 0.1)
        scale[MATERIAL] = 0.1 * (HIGH - LOW)
        scale[TILT] = 0.005
        return scale

    def unpack(self, x: Array) -> tuple[Array, Array]:
        """Return powers ``(fiber,)`` with mean 1 and gains ``(channel,)`` of those in use."""
        last = FIXED + len(self.fibers) - 1
        power = np.exp(np.concatenate([[0.0], x[FIXED:last]]))
        return power / power.mean(), np.exp(x[last:])

    def wanted(self, x: Array) -> Array:
        """Return predicted counts ``(row, channel)``."""
        power, gain = self.unpack(x)
        light = np.exp(terms(x[None, MATERIAL])[0] @ self._coefficients + self._base)
        shaded = light * power[self._own] * (1 - x[VIGNETTING] * self._radius2)
        return np.asarray(shaded[:, None] * gain)

    def residuals(self, x: Array) -> Array:
        """Return weighted residuals, flat; 0 where a channel carries no light."""
        seen = self._counts + np.einsum("trc,t->rc", self._slope, x[TILT])
        return np.asarray(((seen - self.wanted(x)) * self._weight).ravel())

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives ``(residual, parameter)``."""
        power, _ = self.unpack(x)
        weighted = self.wanted(x) * self._weight
        slope = terms_slope(x[MATERIAL]) @ self._coefficients
        columns = [-weighted * one[:, None] for one in slope]
        columns += list(self._slope * self._weight)
        shade = self._radius2 / (1 - x[VIGNETTING] * self._radius2)
        columns.append(weighted * shade[:, None])
        for fiber in range(1, len(self.fibers)):
            share = (self._own == fiber) - power[fiber] / len(self.fibers)
            columns.append(-weighted * share[:, None])
        for channel in range(len(self.channels)):
            only = np.zeros_like(weighted)
            only[:, channel] = -weighted[:, channel]
            columns.append(only)
        return np.stack([column.ravel() for column in columns], axis=1)

    def as_residuals(self, x: Array, log_error: Array) -> Array:
        """Return relative errors ``(n, bend, fiber, point)`` of light as residuals ``(n, ...)``."""
        weighted = self.wanted(x) * self._weight
        found = self.gathered(log_error)[:, :, None] * weighted
        return np.asarray(found.reshape(len(log_error), -1))

    def predictions(self, x: Array) -> list[Array]:
        """Return counts ``(point, 3)`` at all points of every photograph."""
        power, gain = self.unpack(x)
        log_light = self.table.log_light(x[MATERIAL]) + self.correction
        whole = np.full(3, np.nan)
        whole[self.channels] = gain
        return [
            np.exp(log_light[one.bend, one.fiber])[:, None]
            * power[self.fibers.index(one.fiber)]
            * (1 - x[VIGNETTING] * one.radius2)[:, None]
            * whole
            for one in self.measurements
        ]

    def _weights(self, one: Measurement) -> Array:
        """Return 1 over the expected error ``(point, channel)``: noise, and the model's own."""
        counts = one.counts[:, self.channels]
        carries = np.isin(self.channels, one.channels)
        error = np.hypot(one.noise, self.discrepancy[one.bend] * np.abs(counts))
        return np.asarray(np.where(carries, 1 / error, 0.0))
