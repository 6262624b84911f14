"""The calibration as a least-squares problem: parameters to weighted residuals, and derivatives.

Parameters: material (4), tilt (3, rad), vignetting, the logs of all powers but the first (then
scaled to mean 1), the logs of the gains. The data are one row per used point of a photograph and
one column per channel.

The amplitudes z ~ N(0, 1) of the model's error modes A are fitted too, but need no parameters: the
best z for residuals r minimizes |r - A z|^2 + |z|^2, so r - A z and z are what is left to minimize
(variable projection; Golub and Pereyra 2003). Its square is that of r whitened by 1 + A A^T.

The roughness is held near what is known of it by one more residual, the last.
"""

from __future__ import annotations

import numpy as np

from hw.calibration.material import HIGH, LOW, Material
from hw.calibration.material_table import MaterialTable, terms, terms_slope
from hw.calibration.measurement import Measurement
from hw.calibration.model_error import ErrorModes
from hw.errors import CalibrationError
from render.arrays import Array

MATERIAL, ROUGHNESS, TILT, VIGNETTING, FIXED = slice(0, 4), 3, slice(4, 7), 7, 8
ROUGHNESS_KNOWN, ROUGHNESS_HELD = 0.3, 0.05
"""How well the scene's roughness is known, and how tightly the fit holds it, relative. The pad's
faces change the light by less than the model's errors: free, the roughness of five emulated rigs
came out 32 to 68 % too small, and took sigma_v with it by up to 26 %."""
MIN_RELATIVE_ERROR = 0.003
"""Relative error of every point that is always reckoned with."""


class CalibrationResiduals:
    """The data, ready for any parameters.

    Arguments:
        table: light at the reference lines for any material.
        log_correction: ``(bend, fiber, point)`` added to its logarithm.
        modes: independent log errors that the model may have.
        measurements: the photographs.
        roughness: what is known of it.
    """

    def __init__(
        self,
        table: MaterialTable,
        log_correction: Array,
        modes: ErrorModes,
        measurements: list[Measurement],
        roughness: float,
    ) -> None:
        """Gather the used points of all photographs."""
        # A scene may be smoother or rougher than what the table knows.
        self._roughness = float(np.clip(roughness, LOW[ROUGHNESS], HIGH[ROUGHNESS]))
        self._unsure = ROUGHNESS_HELD * self._roughness
        self.table, self.correction, self.measurements = table, log_correction, measurements
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
        carries = [np.isin(self.channels, one.channels) for one in measurements]
        self._carries = np.repeat(carries, np.diff(self.edges), axis=0)
        self._noise = np.repeat([one.noise for one in measurements], np.diff(self.edges))
        self._log_modes = self._gathered_modes(modes)
        self.power_columns = slice(FIXED, FIXED + len(self.fibers) - 1)
        self.size = self.power_columns.stop + len(self.channels)
        self.gain_columns = slice(self.power_columns.stop, self.size)
        self.rows, self.used = self._counts.size, int(self._carries.sum())

    def expect(self, x: Array) -> None:
        """Take the counts that ``x`` predicts for those by which errors are weighed.

        Not those that were seen: their noise would weigh for itself, and dim light seem brighter.
        """
        counts = self.wanted(x)
        error = np.hypot(self._noise[:, None], MIN_RELATIVE_ERROR * counts)
        self._weight = np.where(self._carries, 1 / error, 0.0)
        # (mode, residual)
        weighted = self._log_modes[:, :, None] * (counts * self._weight)
        self._modes = weighted.reshape(len(weighted), -1)
        self._inverse = np.linalg.inv(self._modes @ self._modes.T + np.eye(len(weighted)))

    def gathered(self, values: Array) -> Array:
        """Return ``(n, bend, fiber, point)`` at the rows, ``(n, row)``."""
        return np.concatenate(
            [values[:, one.bend, one.fiber, one.used] for one in self.measurements], axis=1
        )

    def _gathered_modes(self, modes: ErrorModes) -> Array:
        """Return ``(mode, row)`` of all bends; those that no photograph shows are left out."""
        first = np.cumsum([0, *(len(own) for own in modes)])
        found = np.zeros((first[-1], self.edges[-1]))
        for one, begin, end in zip(self.measurements, self.edges, self.edges[1:], strict=False):
            own = slice(first[one.bend], first[one.bend + 1])
            found[own, begin:end] = modes[one.bend][:, one.fiber, one.used]
        return found[found.any(axis=1)]

    def start(self, material: Material) -> Array:
        """Return parameters from ``material`` and the overall brightness of each photograph.

        Errors are weighed by what they predict from then on.
        """
        x = np.zeros(self.size)
        x[MATERIAL] = material.array()
        log_light = terms(x[None, MATERIAL])[0] @ self._coefficients + self._base
        ratio = np.log(np.maximum(self._counts, 1e-3)) - log_light[:, None]
        ratio = np.where(self._carries, ratio, np.nan)
        gain = np.nanmedian(ratio, axis=0)
        over = np.nanmean(ratio - gain, axis=1)
        power = np.array([np.median(over[self._own == own]) for own in range(len(self.fibers))])
        x[self.power_columns] = power[1:] - power[0]
        x[self.gain_columns] = gain + np.log(np.mean(np.exp(power)))
        self.expect(x)
        return x

    def bounds(self) -> tuple[Array, Array]:
        """Return lowest and highest parameters."""
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        low[MATERIAL], high[MATERIAL] = LOW, HIGH
        low[TILT], high[TILT] = -0.1, 0.1
        low[VIGNETTING], high[VIGNETTING] = -0.5, 0.9
        return low, high

    def scale(self) -> Array:
        """Return typical sizes of changes of the parameters."""
        scale = np.full(self.size, 0.1)
        scale[MATERIAL] = 0.1 * (HIGH - LOW)
        scale[TILT] = 0.005
        return scale

    def unpack(self, x: Array) -> tuple[Array, Array]:
        """Return powers ``(fiber,)`` with mean 1 and gains ``(channel,)`` of those in use."""
        power = np.exp(np.concatenate([[0.0], x[self.power_columns]]))
        return power / power.mean(), np.exp(x[self.gain_columns])

    def wanted(self, x: Array) -> Array:
        """Return predicted counts ``(row, channel)``."""
        power, gain = self.unpack(x)
        light = np.exp(terms(x[None, MATERIAL])[0] @ self._coefficients + self._base)
        shaded = light * power[self._own] * (1 - x[VIGNETTING] * self._radius2)
        return np.asarray(shaded[:, None] * gain)

    def residuals(self, x: Array) -> Array:
        """Return what the modes leave of the weighted residuals, and the modes' amplitudes.

        The residuals are flat, and 0 where a channel carries no light. The last one is the
        roughness's distance from what is known of it.
        """
        seen = self._counts + np.einsum("trc,t->rc", self._slope, x[TILT])
        left = self.reduced(((seen - self.wanted(x)) * self._weight).ravel())
        return np.append(left, (x[ROUGHNESS] - self._roughness) / self._unsure)

    def reduced(self, residuals: Array) -> Array:
        """Return what the modes leave of residuals ``(residual, ...)``, then their amplitudes."""
        amplitude = self._inverse @ (self._modes @ residuals)
        return np.concatenate([residuals - self._modes.T @ amplitude, amplitude])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives ``(residual, parameter)`` of ``residuals``."""
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
        left = self.reduced(np.stack([column.ravel() for column in columns], axis=1))
        known = np.zeros((1, self.size))
        known[0, ROUGHNESS] = 1 / self._unsure
        return np.concatenate([left, known])

    def mode_residuals(self) -> Array:
        """Return the model's error modes as data residuals ``(residual, mode)``."""
        return np.asarray(self._modes.T)

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
