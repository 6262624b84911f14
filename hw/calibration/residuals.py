"""The calibration as a least-squares problem: parameters to weighted residuals, and derivatives.

Counts at a point of fiber f, channel c, are modeled as

    gain_c * power_f * light(material_c, f, bend, point) * (1 - v r^2),

with ``light`` of the line model, read at image positions that a small tilt of the camera has moved.
``material_c`` is the same for all channels, but where the skin has an albedo for each.
Parameters: material, tilt (3, rad), vignetting v, the logs of all powers but the first (then
scaled to mean 1), the logs of the gains. The data are one row per used point of a photograph and
one column per channel.

The amplitudes z ~ N(0, 1) of the model's error modes A are fitted too, but need no parameters: the
best z for residuals r minimizes |r - A z|^2 + |z|^2, so r - A z and z are what is left to minimize
(variable projection; Golub and Pereyra 2003). Its square is that of r whitened by 1 + A A^T.

Values of which something is known, as the roughness, are held near the scene's by one more residual
each, the last ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hw.calibration.line_model import LineModel, with_channels
from hw.calibration.measurement import Measurement
from hw.errors import CalibrationError
from optimize.ui.console import counted
from render.arrays import Array

MIN_RELATIVE_ERROR = 0.003
"""Relative error of every point that is always reckoned with."""
MODEL_ERROR_FACTOR = 1.8
"""By how much errors of the model exceed what its modes say. With 1, the values of five emulated
rigs were off by 1.5 standard errors in the root mean square; with this, by 1."""
MIN_FIBERS = 4
INSEPARABLE = 0.9
"""Correlation from which two values are called hard to tell apart."""


class CalibrationResiduals:
    """The data, ready for any parameters.

    ``before`` is the material of the scene: what is known of the rig's is that it is near.
    """

    def __init__(self, model: LineModel, measurements: list[Measurement], before: Array) -> None:
        """Gather the used points of all photographs."""
        self.space = model.space
        size, knowledge = len(self.space.quantities), self.space.knowledge
        self.material, self.tilt, self.vignetting = slice(0, size), slice(size, size + 3), size + 3
        # A scene may be smoother or rougher than what the table knows.
        self._before = np.clip(before, self.space.low, self.space.high)
        # Standard deviations of what is known, one residual each.
        self._known_index = list(knowledge)
        known, self._held = self.space.deviations(self._before)
        self.known_over_held = known / self._held
        self._model, self._measurements = model, measurements
        self.fibers = sorted({photo.fiber for photo in measurements})
        self.channels = sorted({c for photo in measurements for c in photo.channels})
        enough = min(MIN_FIBERS, model.table.coefficients.shape[2])
        if len(self.fibers) < enough:
            raise CalibrationError(
                f"{counted(len(self.fibers), 'fiber was', 'fibers were')} photographed, allowed: "
                f"at least {enough}; capture a sweep with --white 1 of a design that lights as "
                "many",
                field="measurements",
            )

        def gathered(of: Callable[[Measurement], Array]) -> Array:
            """Return what ``of`` returns for every point of a photograph, at those in use."""
            return np.concatenate([of(photo)[photo.used] for photo in measurements])

        def whole(photo: Measurement, *values: object) -> Array:
            return np.tile(np.array(values), (len(photo.used), 1))

        bend, fiber = gathered(lambda photo: whole(photo, photo.bend, photo.fiber)).T
        point = np.concatenate([np.nonzero(photo.used)[0] for photo in measurements])
        self._coefficients = model.table.coefficients[:, bend, fiber, point]
        # What channels have of their own, in the order of those in use; one for all where alike.
        seen = self.channels if self.space.of_channel else [0]
        self._quantities = [self.space.of_channel[c] if self.space.of_channel else range(size)
                            for c in seen]  # fmt: skip

        def by_channel(values: Array) -> Array:
            return values if values.shape[-1] == 1 else values[..., seen]

        correction = model.log_correction[bend, fiber, point]
        self._log_correction = by_channel(with_channels(correction, 1))
        modes = [
            np.where((bend == b)[:, None], by_channel(with_channels(of[:, fiber, point], 2)), 0.0)
            for b, of in enumerate(model.modes)
        ]
        # Those that no photograph shows are left out.
        self._log_modes = np.concatenate([own[own.any(axis=(1, 2))] for own in modes])
        # Index of each row's fiber.
        self._fiber = np.searchsorted(self.fibers, fiber)
        self._radius2 = gathered(lambda photo: photo.radius2)
        self._counts = gathered(lambda photo: photo.counts[:, self.channels])
        slope = gathered(lambda photo: photo.tilt_slope[..., self.channels].swapaxes(0, 1))
        self._slope = slope.swapaxes(0, 1)
        self._carries = gathered(
            lambda photo: whole(photo, *np.isin(self.channels, photo.channels))
        )
        self._noise = gathered(lambda photo: whole(photo, photo.noise))
        powers = self.vignetting + 1
        self.power_columns = slice(powers, powers + len(self.fibers) - 1)
        self.size = self.power_columns.stop + len(self.channels)
        self.gain_columns = slice(self.power_columns.stop, self.size)
        self.rows, self.used = self._counts.size, int(self._carries.sum())

    def start(self, material: Array) -> Array:
        """Return parameters from ``material`` and the overall brightness of each photograph.

        Errors are weighed by what they predict from then on.
        """
        x = np.zeros(self.size)
        x[self.material] = material
        ratio = np.log(np.maximum(self._counts, 1e-3)) - self._log_light(x)
        ratio = np.where(self._carries, ratio, np.nan)
        gain = np.nanmedian(ratio, axis=0)
        excess = np.nanmean(ratio - gain, axis=1)
        power = np.array([np.median(excess[self._fiber == f]) for f in range(len(self.fibers))])
        x[self.power_columns] = power[1:] - power[0]
        x[self.gain_columns] = gain + np.log(np.mean(np.exp(power)))
        self.weigh(x)
        return x

    def weigh(self, x: Array) -> None:
        """Weigh errors by the counts that ``x`` predicts.

        Not by those that were seen: their noise would weigh for itself, and dim light seem
        brighter.
        """
        counts = self._predicted(x)
        error = np.hypot(self._noise, MIN_RELATIVE_ERROR * counts)
        self._weight = np.where(self._carries, 1 / error, 0.0)
        weighted = self._log_modes * (counts * self._weight)
        self.modes = weighted.reshape(len(weighted), -1)
        """The model's error modes as data residuals, ``(mode, residual)``."""
        self._inverse = np.linalg.inv(self.modes @ self.modes.T + np.eye(len(weighted)))

    def bounds(self) -> tuple[Array, Array]:
        """Return lowest and highest parameters."""
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        low[self.material], high[self.material] = self.space.low, self.space.high
        low[self.tilt], high[self.tilt] = -0.1, 0.1
        low[self.vignetting], high[self.vignetting] = -0.5, 0.9
        return low, high

    def scale(self) -> Array:
        """Return typical sizes of changes of the parameters."""
        scale = np.full(self.size, 0.1)
        scale[self.material] = 0.1 * (self.space.high - self.space.low)
        scale[self.tilt] = 0.005
        return scale

    def unpack(self, x: Array) -> tuple[Array, Array]:
        """Return powers ``(fiber,)`` with mean 1 and gains ``(channel,)`` of those in use."""
        power = np.exp(np.concatenate([[0.0], x[self.power_columns]]))
        return power / power.mean(), np.exp(x[self.gain_columns])

    def _log_light(self, x: Array) -> Array:
        """Return the model's log light ``(row, channel)``, of one channel where all are alike."""
        table, material = self._model.table.space, x[self.material]
        seen = np.stack([material[list(of)] for of in self._quantities])
        polynomial = (table.terms(seen) @ self._coefficients).T
        return np.asarray(polynomial + table.log_factor(seen) + self._log_correction)

    def _predicted(self, x: Array) -> Array:
        """Return predicted counts ``(row, channel)``."""
        power, gain = self.unpack(x)
        light = np.exp(self._log_light(x))
        shade = power[self._fiber] * (1 - x[self.vignetting] * self._radius2)
        return np.asarray(light * shade[:, None] * gain)

    def residuals(self, x: Array) -> Array:
        """Return what the modes leave of the weighted residuals, and the modes' amplitudes.

        The residuals are flat, and 0 where a channel carries no light. The last ones are distances
        from what is known of the material.
        """
        seen = self._counts + np.einsum("trc,t->rc", self._slope, x[self.tilt])
        projected = self.projected(((seen - self._predicted(x)) * self._weight).ravel())
        away = (x - np.pad(self._before, (0, len(x) - len(self._before))))[self._known_index]
        return np.concatenate([projected, away / self._held])

    def projected(self, residuals: Array) -> Array:
        """Return what the modes leave of residuals ``(residual, ...)``, then their amplitudes."""
        amplitude = self._inverse @ (self.modes @ residuals)
        return np.concatenate([residuals - self.modes.T @ amplitude, amplitude])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives ``(residual, parameter)`` of ``residuals``."""
        power, _ = self.unpack(x)
        weighted = self._predicted(x) * self._weight
        columns = [-weighted * slope for slope in self._log_slopes(x[self.material])]
        columns += list(self._slope * self._weight)
        shade = self._radius2 / (1 - x[self.vignetting] * self._radius2)
        columns.append(weighted * shade[:, None])
        for fiber in range(1, len(self.fibers)):
            change = (self._fiber == fiber) - power[fiber] / len(self.fibers)
            columns.append(-weighted * change[:, None])
        columns += [-weighted * only for only in np.eye(len(self.channels))]
        projected = self.projected(np.stack([column.ravel() for column in columns], axis=1))
        known = np.eye(self.size)[self._known_index] / self._held[:, None]
        return np.concatenate([projected, known])

    def _log_slopes(self, material: Array) -> Array:
        """Return the derivatives ``(quantity, row, channel)`` of log light by the material."""
        table, rows = self._model.table.space, self._coefficients.shape[1]
        slopes = np.zeros((len(material), rows, len(self._quantities)))
        for channel, of in enumerate(self._quantities):
            seen = material[list(of)]
            own = table.terms_slope(seen) @ self._coefficients
            slopes[list(of), :, channel] = own + table.log_factor_slope(seen)[:, None]
        return slopes

    def predictions(self, x: Array) -> list[Array]:
        """Return counts ``(point, channel)`` at all points of every photograph."""
        power, gain = self.unpack(x)
        log_light = self._model.log_light(x[self.material])
        gains = np.full(self._measurements[0].counts.shape[1], np.nan)
        gains[self.channels] = gain
        return [
            np.exp(with_channels(log_light[photo.bend, photo.fiber], 1))
            * power[self.fibers.index(photo.fiber)]
            * (1 - x[self.vignetting] * photo.radius2)[:, None]
            * gains
            for photo in self._measurements
        ]


@dataclass(frozen=True, eq=False)
class StandardErrors:
    """Standard errors of everything fitted.

    They are carried to the parameters by the fit's own linearization, from

    - photographs: noise, enlarged where more is left than noise and model explain (Birge 1932);
    - model: its error modes: smooth fields, or what renders leave open once they have corrected it;
    - known: what is known of values, considered where they are held more tightly than known
      (Schmidt 1966).

    Arguments:
        names: of the material's quantities.
        material: ``(quantity,)``; parts: the same by source of the error.
        power: ``(fiber,)`` relative, in the order of the fibers that were photographed.
        gain: ``(channel,)`` relative, of the channels that were used.
        correlation: ``(quantity, quantity)`` of the material's values.
    """

    names: tuple[str, ...]
    material: Array
    parts: dict[str, Array]
    power: Array
    gain: Array
    correlation: Array

    def inseparable(self) -> list[tuple[str, str, float]]:
        """Return pairs of values that these photographs hardly tell apart."""
        return [
            (self.names[i], self.names[j], float(self.correlation[i, j]))
            for i in range(len(self.names))
            for j in range(i)
            if abs(self.correlation[i, j]) >= INSEPARABLE
        ]


def standard_errors(problem: CalibrationResiduals, x: Array) -> StandardErrors:
    """Return the standard errors at the fit's end ``x``."""
    slopes, scale = problem.jacobian(x), problem.scale()
    # Scaled normal equations: the parameters' sizes differ by orders, their derivatives do not.
    scaled = slopes * scale
    inverse = scale[:, None] * np.linalg.pinv(scaled.T @ scaled, hermitian=True) * scale
    moves = inverse @ slopes.T
    # What is left of the photographs, in units of what noise and model explain; never below 1.
    residuals = problem.residuals(x)
    excess = max(1.0, float(residuals @ residuals) / (problem.used - len(x)))
    # Held more tightly than it is known: what is not known of it is carried to everything else.
    projected = problem.projected(problem.modes.T)
    known = problem.known_over_held * moves[:, len(projected) :]
    moved = moves[:, : len(projected)] @ projected
    parts = {
        "photographs": excess * np.asarray(moves[:, : problem.rows] @ moves[:, : problem.rows].T),
        "model": MODEL_ERROR_FACTOR**2 * moved @ moved.T,
        "known": known @ known.T,
    }
    covariance = np.sum(list(parts.values()), axis=0)
    se = np.sqrt(np.diag(covariance))
    fibers = len(problem.fibers)
    # Powers have mean 1: the first fiber's error is that of the others' mean.
    to_log = np.zeros((fibers, len(x)))
    to_log[1:, problem.power_columns] = np.eye(fibers - 1)
    power, _ = problem.unpack(x)
    to_log -= (power[:, None] * to_log).sum(axis=0) / fibers
    own = problem.material
    material = covariance[own, own]
    outer = np.sqrt(np.outer(np.diag(material), np.diag(material)))
    return StandardErrors(
        names=problem.space.names,
        material=se[own],
        parts={name: np.sqrt(np.diag(part)[own]) for name, part in parts.items()},
        power=np.sqrt(np.einsum("fi,ij,fj->f", to_log, covariance, to_log)),
        gain=se[problem.gain_columns],
        correlation=material / np.where(outer > 0, outer, 1.0),
    )
