"""Robust designs: good on sensors as they are built, not only on the one that is drawn (6.2).

Perturbed sensors are draws of manufacturing errors. The objective over them is a lower quantile of
S, or its mean minus one standard deviation; both have exact derivatives.

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
from optimize.robust.material_slopes import PER_FIBER
from optimize.scoring import TableScorer
from optimize.search import Objective
from render.chebyshev import differentiation_matrix, interpolation_weights
from render.metric_gradient import score_by_counts
from render.scene import Spread

Measure = Literal["quantile", "spread"]
QUANTILE = 0.1
RESAMPLES = 400
"""Of the draws, for the interval of their lower quantile."""


class PerturbedSensors:
    """Draws of sensors, common to all designs.

    Arguments of the constructor:
        scorer: the sensor as drawn.
        spreads: tolerances by name.
        slopes: of the materials among them, from `material_slopes`.
        draws: number of sensors.
        seed: of the draws.
    """

    def __init__(
        self,
        scorer: TableScorer,
        spreads: Mapping[str, Spread],
        slopes: Mapping[str, Array],
        *,
        draws: int,
        seed: int,
    ) -> None:
        rng = np.random.default_rng([seed, 62])
        self.scorer, self.draws = scorer, draws
        self.errors = {
            name: spread.draw(rng, (draws, scorer.fibers if name in PER_FIBER else 1))
            for name, spread in spreads.items()
        }
        table = scorer.table
        self._turn = np.zeros((draws, scorer.fibers)) + self.errors.get("fiber_angle", 0.0)
        self._factor = np.zeros((draws, scorer.fibers))
        for name in ("led_power", "camera_gain"):
            self._factor = self._factor + self.errors.get(name, 0.0)
        derivative = differentiation_matrix(table.phi)

        def with_derivative(values: Array) -> tuple[Array, Array]:
            flat = values.reshape(*values.shape[:2], -1)
            return flat, np.einsum("ij,fjx->fix", derivative, flat)

        self._light = with_derivative(table.exposure * table.T)
        self._slopes = {name: with_derivative(slopes[name]) for name in spreads if name in slopes}

    def turned(self, phi: Array) -> Array:
        """Return where fibers point, ``(draw, F)`` rad, that were meant to point to ``phi``."""
        low, high = self.scorer.phi_bounds
        return np.asarray(np.clip(phi + self._turn, low, high))

    def fraction_at_end(self, phi: Array) -> float:
        """Return which part of the fibers an error turned beyond what the table covers."""
        return float((self.turned(phi) != phi + self._turn).mean())

    def scores(self, design: Design) -> Array:
        """Return S ``(draw,)`` of ``design`` on every sensor."""
        out = np.empty(self.draws)
        for draw in range(self.draws):
            light, _ = self._light_of(draw, design.phi)
            counts = self._superposed(light, design.power)
            out[draw] = self.scorer.score_block(counts[..., None])[0]
        return out

    def gradients(self, design: Design) -> tuple[Array, Array, Array]:
        """Return S ``(draw,)`` and its derivatives.

        By the directions, ``(draw, F)`` per rad, and by power in the channels, ``(draw, F, C)``.
        """
        scorer = self.scorer
        scores, slopes = np.empty(self.draws), np.empty((self.draws, scorer.fibers))
        by_power = np.empty((self.draws, *design.power.shape))
        shape = (scorer.bends, scorer.sites, scorer.facets, scorer.channels)
        for draw in range(self.draws):
            light, by_phi = self._light_of(draw, design.phi)
            counts = self._superposed(light, design.power).reshape(shape)
            scores[draw], by_counts = score_by_counts(counts, scorer.table.lam, scorer.config)
            by_counts = by_counts.reshape(-1, scorer.channels)
            if scorer.table.by_channel:
                grown = by_phi.reshape(scorer.fibers, *by_counts.shape)
                slopes[draw] = np.einsum("xc,fc,fxc->f", by_counts, design.power, grown)
                tinted = light.reshape(scorer.fibers, *by_counts.shape)
                by_power[draw] = np.einsum("xc,fxc->fc", by_counts, tinted)
            else:
                slopes[draw] = np.einsum("xf,fx->f", by_counts @ design.power.T, by_phi)
                by_power[draw] = light @ by_counts
        return scores, slopes, by_power

    def _superposed(self, light: Array, power: Array) -> Array:
        """Return counts ``(B * S * K, C)`` of light ``(F, B * S * K [* C])``."""
        if self.scorer.table.by_channel:
            tinted = light.reshape(len(light), -1, self.scorer.channels)
            return np.asarray(np.einsum("fxc,fc->xc", tinted, power))
        return np.asarray(np.einsum("fx,fc->xc", light, power))

    def _light_of(self, draw: int, phi: Array) -> tuple[Array, Array]:
        """Return counts per unit of LED power and their derivative by phi, ``(F, cell)`` each."""
        weights = interpolation_weights(self.scorer.table.phi, self.turned(phi)[draw])

        def at(values: Array) -> Array:
            return np.asarray(np.matmul(weights[:, None], values)[:, 0])

        light, by_phi = (at(part) for part in self._light)
        log, growth = self._factor[draw][:, None], np.zeros_like(light)
        for name, (slope, change) in self._slopes.items():
            error = self.errors[name][draw][:, None]
            log, growth = log + error * at(slope), growth + error * at(change)
        factor = np.exp(log)
        return light * factor, factor * (by_phi + light * growth)


@dataclass(frozen=True, eq=False)
class RobustRating:
    """What becomes of a design on sensors as built.

    Arguments:
        nominal: S on the sensor as drawn.
        mean, deviation: of S over built sensors.
        low: lower 10 % quantile of S.
        low_interval: its 95 % bootstrap interval over the draws.
        draws: number of sensors.
    """

    nominal: float
    mean: float
    deviation: float
    low: float
    low_interval: tuple[float, float]
    draws: int

    def to_json(self) -> dict[str, object]:
        """Return plain data."""
        return {**vars(self), "low_interval": list(self.low_interval)}


def rate_robustly(scorer: TableScorer, sensors: PerturbedSensors, design: Design) -> RobustRating:
    """Return the rating of ``design`` over ``sensors`` that had no part in making it."""
    scores = sensors.scores(design)
    rng = np.random.default_rng(0)
    resampled = rng.choice(scores, (RESAMPLES, len(scores)))
    lows = np.quantile(resampled, QUANTILE, axis=1)
    low, high = np.quantile(lows, [0.025, 0.975])
    return RobustRating(
        nominal=scorer.score(design.phi, design.power),
        mean=float(scores.mean()),
        deviation=float(scores.std(ddof=1)),
        low=float(np.quantile(scores, QUANTILE)),
        low_interval=(float(low), float(high)),
        draws=len(scores),
    )


class RobustScore(Objective):
    """The objective over drawn sensors; see `optimize.search.local_refinement.Objective`."""

    def __init__(self, sensors: PerturbedSensors, measure: Measure) -> None:
        """Take the sensors and what is made of the scores on them."""
        self.sensors, self.measure = sensors, measure
        self._weights = _quantile_weights(sensors.draws)

    def values(self, designs: Sequence[Design]) -> Array:
        """Return the lower quantiles, or means minus one standard deviation, in counts."""
        return np.array([self._of(self.sensors.scores(design))[0] for design in designs])

    def gradient(self, design: Design) -> tuple[float, Array, Array]:
        """Return the objective and its derivatives by directions ``(F,)`` and power ``(F, C)``."""
        scores, slopes, by_power = self.sensors.gradients(design)
        value, weight = self._of(scores)
        return value, weight @ slopes, np.tensordot(weight, by_power, 1)

    def _of(self, scores: Array) -> tuple[float, Array]:
        """Return the objective of ``scores`` ``(draw,)`` and its derivative by each of them."""
        count = len(scores)
        if self.measure == "spread":
            deviation = float(scores.std(ddof=1))
            slope = (scores - scores.mean()) / ((count - 1) * max(deviation, 1e-12))
            return float(scores.mean()) - deviation, 1.0 / count - slope
        order = np.argsort(scores, kind="stable")
        weight = np.empty(count)
        weight[order] = self._weights
        return float(weight @ scores), weight


def _quantile_weights(count: int) -> Array:
    """Return weights ``(count,)`` of ascending scores that make their lower quantile.

    Harrell and Davis (1982): the i-th order statistic weighs as much as a Beta((n + 1) p,
    (n + 1) (1 - p)) variable falls between (i - 1) / n and i / n. Unlike a single order statistic
    its derivative does not jump from one sensor to another.
    """
    from scipy.special import betainc

    edges = np.arange(count + 1) / count
    a, b = (count + 1) * QUANTILE, (count + 1) * (1 - QUANTILE)
    return np.asarray(np.diff(betainc(a, b, edges)))
