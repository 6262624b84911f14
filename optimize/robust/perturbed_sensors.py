"""Robust designs: good on sensors as they are built, not only on the one that is drawn (6.2).

Perturbed sensors are draws of manufacturing errors. The objective over them is a lower quantile of
what they are worth, or its mean minus one standard deviation; both have exact derivatives.

All designs meet the same errors, so that their comparison keeps only what differs. Relative errors
act as factors ``exp(error)``; errors of the material act through its slopes in log T, to first
order. A direction that an error turns beyond what the table covers stays at its end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from optimize.design import Array, Design
from optimize.objectives import ObjectiveName, sign_of
from optimize.robust.material_slopes import PER_FIBER
from optimize.robust.worth import Worth
from optimize.search import Objective
from render.chebyshev import differentiation_matrix
from render.scene import Spread

Measure = Literal["quantile", "spread"]
QUANTILE = 0.1
RESAMPLES = 400
"""Of the draws, for the interval of their lower quantile."""


class PerturbedSensors:
    """Draws of sensors, common to all designs.

    Arguments of the constructor:
        worth: what colors are worth, and the sensor as drawn.
        spreads: tolerances by name.
        slopes: of the materials among them, from `material_slopes`.
        draws: number of sensors.
        seed: of the draws.
    """

    def __init__(
        self,
        worth: Worth,
        spreads: Mapping[str, Spread],
        slopes: Mapping[str, Array],
        *,
        draws: int,
        seed: int,
    ) -> None:
        rng = np.random.default_rng([seed, 62])
        scorer = worth.scorer
        self.worth, self.draws = worth, draws
        self.errors = {
            name: spread.draw(rng, (draws, scorer.fibers if name in PER_FIBER else 1))
            for name, spread in spreads.items()
        }
        self._turn = np.zeros((draws, scorer.fibers)) + self.errors.get("fiber_angle", 0.0)
        self._factor = np.zeros((draws, scorer.fibers))
        for name in ("led_power", "camera_gain"):
            self._factor = self._factor + self.errors.get(name, 0.0)
        derivative, patches = differentiation_matrix(scorer.table.phi), worth.cells[2]
        self._slopes = {}
        for name in spreads:
            if name in slopes:
                flat = slopes[name][:, :, :, :, :patches].reshape(*slopes[name].shape[:2], -1)
                self._slopes[name] = flat, np.einsum("ij,fjx->fix", derivative, flat)

    def turned(self, phi: Array) -> Array:
        """Return where fibers point, ``(draw, F)`` rad, that were meant to point to ``phi``."""
        low, high = self.worth.scorer.phi_bounds
        return np.asarray(np.clip(phi + self._turn, low, high))

    def fraction_at_end(self, phi: Array) -> float:
        """Return which part of the fibers an error turned beyond what the table covers."""
        return float((self.turned(phi) != phi + self._turn).mean())

    def values(self, design: Design) -> Array:
        """Return what ``design`` is worth on every sensor, ``(draw,)``."""
        out = np.empty(self.draws)
        for draw in range(self.draws):
            light, _ = self._light_of(draw, design.phi)
            out[draw] = self.worth.value(self.worth.superposed(light, design.power))
        return out

    def gradients(self, design: Design) -> tuple[Array, Array, Array]:
        """Return the worth ``(draw,)`` and its derivatives.

        By the directions, ``(draw, F)`` per rad, and by power in the channels, ``(draw, F, C)``.
        """
        values, slopes = np.empty(self.draws), np.empty((self.draws, len(design.phi)))
        by_power = np.empty((self.draws, *design.power.shape))
        for draw in range(self.draws):
            light, turned = self._light_of(draw, design.phi)
            counts = self.worth.superposed(light, design.power)
            values[draw], by_counts = self.worth.slopes(counts)
            by_light, by_power[draw] = self.worth.chain(by_counts, light, design.power)
            slopes[draw] = (by_light * turned).sum(axis=1)
        return values, slopes, by_power

    def _light_of(self, draw: int, phi: Array) -> tuple[Array, Array]:
        """Return counts per unit of LED power and their derivative by phi, ``(F, cell)`` each."""
        turned = self.turned(phi)[draw]
        weights, (light, by_phi) = self.worth.weights(turned), self.worth.at(turned)

        def at(values: Array) -> Array:
            return np.asarray((weights @ values)[:, 0])

        log, growth = self._factor[draw][:, None], np.zeros_like(light)
        for name, (slope, change) in self._slopes.items():
            error = self.errors[name][draw][:, None]
            log, growth = log + error * at(slope), growth + error * at(change)
        factor = np.exp(log)
        return light * factor, factor * (by_phi + light * growth)


@dataclass(frozen=True, eq=False)
class RobustRating:
    """What becomes of a design on sensors as built: S in counts, or a reader's degrees.

    Arguments:
        objective: whose figures these are.
        nominal: on the sensor as drawn.
        mean, deviation: over built sensors.
        tenth: what one built sensor in ten is worse than.
        tenth_interval: its 95 % bootstrap interval over the draws.
        draws: number of sensors.
    """

    objective: ObjectiveName
    nominal: float
    mean: float
    deviation: float
    tenth: float
    tenth_interval: tuple[float, float]
    draws: int

    def better(self, other: RobustRating) -> bool:
        """Return whether one sensor in ten is worse than less here than with ``other``."""
        sign = sign_of(self.objective)
        return sign * self.tenth > sign * other.tenth

    def to_json(self) -> dict[str, object]:
        """Return plain data."""
        return {**vars(self), "tenth_interval": list(self.tenth_interval)}


def rate_robustly(sensors: PerturbedSensors, design: Design) -> RobustRating:
    """Return the rating of ``design`` over ``sensors`` that had no part in making it."""
    values, worth = sensors.values(design), sensors.worth
    rng = np.random.default_rng(0)
    resampled = rng.choice(values, (RESAMPLES, len(values)))
    tenths = worth.sign * np.quantile(resampled, QUANTILE, axis=1)
    low, high = np.quantile(tenths, [0.025, 0.975])
    drawn = worth.superposed(worth.at(design.phi)[0], design.power)
    return RobustRating(
        objective=worth.objective,
        nominal=worth.sign * worth.value(drawn),
        mean=worth.sign * float(values.mean()),
        deviation=float(values.std(ddof=1)),
        tenth=worth.sign * float(np.quantile(values, QUANTILE)),
        tenth_interval=(float(low), float(high)),
        draws=len(values),
    )


class RobustWorth(Objective):
    """The objective over drawn sensors; see `optimize.search.local_refinement.Objective`."""

    def __init__(self, sensors: PerturbedSensors, measure: Measure) -> None:
        """Take the sensors and what is made of their worths."""
        self.sensors, self.measure = sensors, measure
        self._weights = _quantile_weights(sensors.draws)

    def values(self, designs: Sequence[Design]) -> Array:
        """Return the lower quantiles, or means minus one standard deviation."""
        return np.array([self._of(self.sensors.values(design))[0] for design in designs])

    def gradient(self, design: Design) -> tuple[float, Array, Array]:
        """Return the objective and its derivatives by directions ``(F,)`` and power ``(F, C)``."""
        values, slopes, by_power = self.sensors.gradients(design)
        value, weight = self._of(values)
        return value, weight @ slopes, np.tensordot(weight, by_power, 1)

    def _of(self, values: Array) -> tuple[float, Array]:
        """Return the objective of ``values`` ``(draw,)`` and its derivative by each of them."""
        count = len(values)
        if self.measure == "spread":
            deviation = float(values.std(ddof=1))
            slope = (values - values.mean()) / ((count - 1) * max(deviation, 1e-12))
            return float(values.mean()) - deviation, 1.0 / count - slope
        order = np.argsort(values, kind="stable")
        weight = np.empty(count)
        weight[order] = self._weights
        return float(weight @ values), weight


def _quantile_weights(count: int) -> Array:
    """Return weights ``(count,)`` of ascending values that make their lower quantile.

    Harrell and Davis (1982): the i-th order statistic weighs as much as a Beta((n + 1) p,
    (n + 1) (1 - p)) variable falls between (i - 1) / n and i / n. Unlike a single order statistic
    its derivative does not jump from one sensor to another.
    """
    from scipy.special import betainc

    edges = np.arange(count + 1) / count
    a, b = (count + 1) * QUANTILE, (count + 1) * (1 - QUANTILE)
    return np.asarray(np.diff(betainc(a, b, edges)))
