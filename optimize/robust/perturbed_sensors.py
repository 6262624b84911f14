"""Robust designs: good on sensors as they are built, not only on the one that is drawn (6.2).

Perturbed sensors are draws of manufacturing errors. The objective over them is a lower quantile of
a merit, or its mean minus one standard deviation; both have exact derivatives.

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
from optimize.scoring import Merit
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
        merit: of counts, on the sensor as drawn.
        spreads: tolerances by name.
        slopes: of the materials among them, from `material_slopes`.
        draws: number of sensors.
        seed: of the draws.
    """

    def __init__(
        self,
        merit: Merit,
        spreads: Mapping[str, Spread],
        slopes: Mapping[str, Array],
        *,
        draws: int,
        seed: int,
    ) -> None:
        rng = np.random.default_rng([seed, 62])
        scorer = merit.scorer
        self.merit, self.draws = merit, draws
        self.errors = {
            name: spread.draw(rng, (draws, scorer.fibers if name in PER_FIBER else 1))
            for name, spread in spreads.items()
        }
        self._turn = np.zeros((draws, scorer.fibers)) + self.errors.get("fiber_angle", 0.0)
        self._factor = np.zeros((draws, scorer.fibers))
        for name in ("led_power", "camera_gain"):
            self._factor = self._factor + self.errors.get(name, 0.0)
        derivative = differentiation_matrix(scorer.table.phi)
        self._slopes = {}
        for name in spreads:
            if name in slopes:
                flat = merit.flat(slopes[name])
                self._slopes[name] = flat, np.einsum("ij,fjx->fix", derivative, flat)

    def turned(self, phi: Array) -> Array:
        """Return where fibers point, ``(draw, F)`` rad, that were meant to point to ``phi``."""
        low, high = self.merit.scorer.phi_bounds
        return np.asarray(np.clip(phi + self._turn, low, high))

    def fraction_at_end(self, phi: Array) -> float:
        """Return which part of the fibers an error turned beyond what the table covers."""
        return float((self.turned(phi) != phi + self._turn).mean())

    def values(self, design: Design) -> Array:
        """Return the merit of ``design`` on every sensor, ``(draw,)``."""
        out = np.empty(self.draws)
        for draw, phi in enumerate(self.turned(design.phi)):
            light = self.merit.light(phi) * self._factors(draw, phi)
            counts = self.merit.superposed(light, design.power)
            out[draw] = self.merit.values(counts[None])[0]
        return out

    def gradients(self, design: Design) -> tuple[Array, Array, Array]:
        """Return the merit ``(draw,)`` and its derivatives.

        By the directions, ``(draw, F)`` per rad, and by power in the channels, ``(draw, F, C)``.
        """
        found = []
        for draw, phi in enumerate(self.turned(design.phi)):
            light, factor = self.merit.light(phi), self._factors(draw, phi)
            growth = self._logs(draw, phi, 1)
            turned = factor * (self.merit.turned(phi) + light * growth)
            found.append(self.merit.gradient_by(light * factor, turned, design.power))
        return (
            np.array([one.value for one in found]),
            np.array([one.phi for one in found]),
            np.array([one.power for one in found]),
        )

    def _factors(self, draw: int, phi: Array) -> Array:
        """Return by what errors multiply the light of fibers at ``phi`` ``(F,)``, by cell."""
        own = self._factor[draw].reshape(-1, *(1 for _ in self.merit.cells))
        return np.asarray(np.exp(own + self._logs(draw, phi, 0)))

    def _logs(self, draw: int, phi: Array, order: int) -> Array:
        """Return the logarithm of what errors of the material do, or its derivative by phi."""
        total = np.zeros((len(phi), *self.merit.cells))
        for name, slopes in self._slopes.items():
            error = self.errors[name][draw].reshape(-1, *(1 for _ in self.merit.cells))
            total = total + error * self.merit.at(slopes[order], phi)
        return total


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
    values, merit = sensors.values(design), sensors.merit
    rng = np.random.default_rng(0)
    resampled = rng.choice(values, (RESAMPLES, len(values)))
    tenths = merit.sign * np.quantile(resampled, QUANTILE, axis=1)
    low, high = np.quantile(tenths, [0.025, 0.975])
    return RobustRating(
        objective=merit.objective,
        nominal=merit.sign * merit.value(design.phi, design.power),
        mean=merit.sign * float(values.mean()),
        deviation=float(values.std(ddof=1)),
        tenth=merit.sign * float(np.quantile(values, QUANTILE)),
        tenth_interval=(float(low), float(high)),
        draws=len(values),
    )


class RobustObjective(Objective):
    """The objective over drawn sensors; see `optimize.search.local_refinement.Objective`."""

    def __init__(self, sensors: PerturbedSensors, measure: Measure) -> None:
        """Take the sensors and what is made of the merit on them."""
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
