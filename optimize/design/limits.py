"""What a search may choose: the builder's constraints as arrays, and how candidates obey them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optimize.design.design import Array, Colors, Design, baseline_design
from render.errors import DesignError
from render.geometry import FiberHolder
from render.scene import COLORS, Scene

TURNS = 16
"""Steps in which fibers that would meet are turned upright."""
FORBIDDEN = 1e9
"""Cost of a color that a fiber must not have; above any sum of the others."""


@dataclass(frozen=True, eq=False)
class SearchLimits:
    """SearchLimits of a search.

    Arguments:
        allowed: ``(F, 3)`` which colors each fiber may have.
        led_counts: ``(3,)`` LEDs of each color, which is the most fibers that may have it.
        led_power: ``(3,)`` power of an LED that is on.
        low, high: ``(F, interval)`` rad, allowed directions; unused intervals repeat the last.
        step: rad between directions, counted from 0; 0 for none. Fixed directions need not fit.
        continuous_power: whether fibers may have less than ``led_power``.
        holder: in which neighboring fibers must not meet; None where nothing holds them.
    """

    allowed: NDArray[np.bool_]
    led_counts: Colors
    led_power: Array
    low: Array
    high: Array
    step: float
    continuous_power: bool
    holder: FiberHolder | None = None

    @property
    def colors_limited(self) -> bool:
        """Whether some coloring is not allowed."""
        return bool(not self.allowed.all() or (self.led_counts < len(self.allowed)).any())

    @property
    def colors_alike(self) -> bool:
        """Whether exchanging two colors in all fibers keeps every coloring allowed."""
        return bool(self.allowed.all() and (self.led_counts == self.led_counts[0]).all())

    @property
    def fixed_directions(self) -> NDArray[np.bool_]:
        """``(F,)`` fibers whose direction is fixed."""
        return np.asarray(self.low[:, 0] == self.high[:, -1])

    @property
    def directions_limited(self) -> bool:
        """Whether some direction is not allowed."""
        whole = (self.low[:, 0] == 0.0) & (self.high[:, -1] == math.pi)
        return bool(self.low.shape[1] > 1 or not whole.all() or self.step > 0.0)

    def fits(self, colors: Colors) -> NDArray[np.bool_]:
        """Return which of ``colors`` ``(N, F)`` are allowed."""
        chosen = np.asarray(colors)
        permitted = self.allowed[np.arange(chosen.shape[1]), chosen].all(axis=1)
        used = np.stack([(chosen == c).sum(axis=1) for c in range(3)], axis=1)
        return np.asarray(permitted & (used <= self.led_counts).all(axis=1))

    def nearest_colors(self, preference: Array) -> Colors:
        """Return the allowed colors ``(F,)`` of greatest total ``preference`` ``(F, 3)``.

        An assignment problem: every fiber takes one of the LEDs that there are.

        Raises:
            DesignError: no coloring is allowed.
        """
        from scipy.optimize import linear_sum_assignment

        slots = np.repeat(np.arange(3), np.minimum(self.led_counts, len(self.allowed)))
        cost = np.where(self.allowed, -preference, FORBIDDEN)[:, slots]
        if cost.shape[1] >= len(cost):
            row, column = linear_sum_assignment(cost)
            if cost[row, column].max() < FORBIDDEN:
                return np.asarray(slots[column], dtype=np.int64)
        raise DesignError(
            "no choice of colors fulfills the constraints: fix fewer fibers or allow more LEDs "
            "per color",
            field="constraints",
        )

    def fits_holder(self, phi: Array) -> bool:
        """Return whether no fibers of ``phi`` ``(F,)`` rad meet in the holder."""
        return self.holder is None or bool((self.holder.slack(phi) >= 0.0).all())

    def nearest_directions(self, phi: Array) -> Array:
        """Return allowed directions near ``phi`` ``(..., F)`` rad: the nearest of each fiber.

        Fibers that would meet in the holder are turned together towards the normal of their edge,
        in `TURNS` steps at most, until they do not.
        """
        nearest = self._nearest_alone(phi)
        if self.holder is None:
            return nearest
        upright = self._nearest_alone(np.full(phi.shape[-1], math.pi / 2))
        rows = nearest.reshape(-1, phi.shape[-1])
        turned, turns = rows, np.zeros(rows.shape)
        while (crowded := self.holder.crowded(turned)).any():
            movable = crowded & (turns < TURNS)
            if not movable.any():
                problem = next(self.holder.problems(turned[crowded.any(axis=1)][0]))
                raise DesignError(
                    f"no directions fulfill the constraints: {problem}; fix or forbid fewer "
                    "directions, or make the holder thinner",
                    field="constraints",
                )
            turns += movable
            between = self._nearest_alone(upright + (1.0 - turns / TURNS) * (rows - upright))
            turned = np.where(turns > 0, between, rows)
        return np.asarray(turned.reshape(phi.shape))

    def _nearest_alone(self, phi: Array) -> Array:
        """Return the nearest allowed direction of each fiber, whatever its neighbors do."""
        if not self.directions_limited:
            return phi
        ends = np.clip(phi[..., None], self.low, self.high)
        if self.step > 0.0:
            # A step may lie outside its interval at an end; then the next one inside is taken.
            lowest = np.ceil(self.low / self.step - 1e-9) * self.step
            highest = np.floor(self.high / self.step + 1e-9) * self.step
            on_step = np.clip(np.round(ends / self.step) * self.step, lowest, highest)
            on_step = np.where(lowest > highest, np.inf, np.minimum(on_step, math.pi))
            ends = np.where(self.fixed_directions[:, None], ends, on_step)
        nearest = np.abs(ends - phi[..., None]).argmin(axis=-1)
        return np.asarray(np.take_along_axis(ends, nearest[..., None], axis=-1)[..., 0])

    def nearest_design(self, design: Design) -> Design:
        """Return the allowed design nearest to ``design``, at full allowed power."""
        preference = np.eye(3)[np.maximum(design.colors, 0)]
        colors = self.nearest_colors(preference) if self.colors_limited else design.colors
        power = np.eye(3)[colors] * self.led_power * (design.colors >= 0)[:, None]
        return Design(self.nearest_directions(design.phi), power)

    def dimmed(self, design: Design) -> Design:
        """Return ``design`` with no LED above its limit and nothing else changed."""
        return Design(design.phi, np.minimum(design.power, self.led_power))


def unlimited(fibers: int) -> SearchLimits:
    """Return the limits that allow everything."""
    return SearchLimits(
        allowed=np.ones((fibers, 3), dtype=bool),
        led_counts=np.full(3, fibers, dtype=np.int64),
        led_power=np.ones(3),
        low=np.zeros((fibers, 1)),
        high=np.full((fibers, 1), math.pi),
        step=0.0,
        continuous_power=False,
    )


def limits_of(scene: Scene) -> SearchLimits:
    """Return the limits that the scene's constraints set.

    Raises:
        DesignError: the constraints contradict each other.
    """
    fibers, given = scene.fibers.count, scene.constraints
    free = unlimited(fibers)
    if given is None:
        return replace(free, holder=FiberHolder.of(scene))
    allowed = free.allowed.copy()
    for entry in given.fixed:
        if entry.color is not None:
            allowed[entry.fiber] = np.arange(3) == COLORS.index(entry.color)
    intervals = [given.intervals(fiber) for fiber in range(fibers)]
    size = max(map(len, intervals))
    padded = np.array([part + part[-1:] * (size - len(part)) for part in intervals])
    limits = SearchLimits(
        allowed=allowed,
        led_counts=np.array(given.max_counts(fibers), dtype=np.int64),
        led_power=np.array([given.power_red, given.power_green, given.power_blue]),
        low=padded[..., 0],
        high=padded[..., 1],
        step=given.angle_step or 0.0,
        continuous_power=given.continuous_power,
        holder=FiberHolder.of(scene),
    )
    limits.nearest_colors(np.zeros((fibers, 3)))
    limits.nearest_directions(np.full(fibers, math.pi / 2))
    return limits


def dimmed_baseline(scene: Scene) -> Design:
    """Return the design to beat (thesis 5.1), with no LED above what the scene allows."""
    return limits_of(scene).dimmed(baseline_design(scene))
