"""What a search may choose: the builder's constraints as arrays, and how candidates obey them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optimize.design.design import DARK, Array, Colors, Design, baseline_design, one_led
from render.errors import DesignError
from render.geometry import FiberHolder
from render.scene import OFF, RGB, Constraints, Palette, Scene
from render.scene.places import images

TURNS = 16
"""Steps in which fibers that would meet are turned upright."""
FORBIDDEN = 1e9
"""Cost of a color that a fiber must not have; above any sum of the others."""


@dataclass(frozen=True, eq=False)
class SearchLimits:
    """SearchLimits of a search.

    Arguments:
        allowed: ``(F, choice)`` which colors each fiber may have; the last choice is off where
            that is one.
        led_counts: ``(choice,)`` LEDs of each color, which is the most fibers that may have it.
        led_power: ``(color,)`` power of an LED that is on.
        low, high: ``(F, interval)`` rad, allowed directions; unused intervals repeat the last.
        step: rad between directions, counted from 0; 0 for none. Fixed directions need not fit.
        continuous_power: whether fibers may have less than ``led_power``.
        holder: in which neighboring fibers must not meet; None where nothing holds them.
        most_lit: fibers that may be lit at once; None is all.
        ties: ``(F,)`` group of each fiber, 0..G-1, whose fibers have one color or are all off;
            None where each is alone.
    """

    allowed: NDArray[np.bool_]
    led_counts: Colors
    led_power: Array
    low: Array
    high: Array
    step: float
    continuous_power: bool
    holder: FiberHolder | None = None
    palette: Palette = RGB
    most_lit: int | None = None
    ties: Colors | None = None

    @property
    def groups(self) -> Colors:
        """``(F,)`` group of each fiber: that of `ties`, or its own."""
        return np.arange(len(self.allowed)) if self.ties is None else self.ties

    @property
    def may_be_off(self) -> bool:
        """Whether off is a choice."""
        return bool(self.allowed.shape[1] > len(self.palette.names))

    @property
    def colors_limited(self) -> bool:
        """Whether some coloring is not allowed."""
        counted = self.led_counts < len(self.allowed)
        limited = counted.any() or self.some_stay_off or self.ties is not None
        return bool(not self.allowed.all() or limited)

    @property
    def some_stay_off(self) -> bool:
        """Whether fewer fibers may be lit than there are."""
        return self.most_lit is not None and self.most_lit < len(self.allowed)

    @property
    def colors_alike(self) -> bool:
        """Whether exchanging two colors in all fibers keeps every coloring allowed."""
        counts = self.led_counts[: len(self.palette.names)]
        return bool(self.allowed.all() and (counts == counts[0]).all())

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
        """Return which of ``colors`` ``(N, F)`` are allowed; -1 is off."""
        chosen = np.asarray(colors)
        permitted = self.allowed[np.arange(chosen.shape[1]), chosen].all(axis=1)
        if not self.may_be_off:
            permitted &= (chosen != DARK).all(axis=1)
        if self.most_lit is not None:
            permitted &= (chosen != DARK).sum(axis=1) <= self.most_lit
        if self.ties is not None:
            first = np.unique(self.ties, return_index=True)[1]
            permitted &= (chosen == chosen[:, first[self.ties]]).all(axis=1)
        names = range(len(self.palette.names))
        used = np.stack([(chosen == c).sum(axis=1) for c in names], axis=1)
        return np.asarray(permitted & (used <= self.led_counts[: len(names)]).all(axis=1))

    def nearest_colors(self, preference: Array) -> Colors:
        """Return the allowed colors ``(F,)`` of greatest total ``preference`` ``(F, choice)``.

        An assignment problem: every fiber takes one of the LEDs that there are. Where only some may
        be lit, LEDs beyond so many are taken by fibers that are not there. Groups that are tied
        take as many LEDs at once as they have fibers: an integer program.

        Raises:
            DesignError: no coloring is allowed.
        """
        from scipy.optimize import linear_sum_assignment

        if self.ties is not None:
            return self._nearest_tied(preference)
        choices = np.arange(self.allowed.shape[1])
        slots = np.repeat(choices, np.minimum(self.led_counts, len(self.allowed)))
        cost = np.where(self.allowed, -preference, FORBIDDEN)[:, slots]
        if self.most_lit is not None:
            leds = slots < len(self.palette.names)
            absent = max(int(leds.sum()) - self.most_lit, 0)
            cost = np.vstack([cost, np.tile(np.where(leds, 0.0, FORBIDDEN), (absent, 1))])
        if cost.shape[1] >= len(cost):
            row, column = linear_sum_assignment(cost)
            if cost[row, column].max() < FORBIDDEN:
                return self.colors_of(slots[column[: len(self.allowed)]])
        raise _unfulfilled()

    def _nearest_tied(self, preference: Array) -> Colors:
        """Return the allowed colors of greatest preference where fibers are tied."""
        from scipy.optimize import Bounds, LinearConstraint, milp

        groups, choices = self.groups, self.allowed.shape[1]
        count = int(groups.max()) + 1
        worth, allowed = np.zeros((count, choices)), np.ones((count, choices))
        np.add.at(worth, groups, preference)
        np.minimum.at(allowed, groups, self.allowed)
        size = np.bincount(groups).astype(np.float64)
        one_each = np.kron(np.eye(count), np.ones(choices))
        used = np.kron(size, np.eye(choices))
        lit = np.kron(size, np.arange(choices) < len(self.palette.names))
        most = len(groups) if self.most_lit is None else self.most_lit
        found = milp(
            -worth.ravel(),
            integrality=np.ones(worth.size),
            bounds=Bounds(0.0, allowed.ravel()),
            constraints=[
                LinearConstraint(one_each, 1.0, 1.0),
                LinearConstraint(used, -np.inf, self.led_counts.astype(np.float64)),
                LinearConstraint(lit[None], -np.inf, float(most)),
            ],
        )
        if found.x is None:
            raise _unfulfilled()
        return self.colors_of(found.x.reshape(worth.shape).argmax(axis=1)[groups])

    def colors_of(self, choices: Colors) -> Colors:
        """Return color indices of numbers of choices: the one after the last color is off, -1."""
        return np.where(choices == len(self.palette.names), DARK, choices).astype(np.int64)

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

    def allowed_start(self, design: Design) -> Design:
        """Return ``design`` where a search may begin at it, else the nearest one where it may."""
        if self.colors_limited or self.directions_limited:
            return self.nearest_design(design)
        if not self.fits_holder(design.phi):
            return replace(design, phi=self.nearest_directions(design.phi))
        return design

    def nearest_design(self, design: Design) -> Design:
        """Return the allowed design nearest to ``design``, at full allowed power."""
        colors, choices = design.colors, self.allowed.shape[1]
        if self.colors_limited:
            # Where a fiber cannot be off it keeps an LED on paper, and stays dark.
            wanted = one_led(colors if self.may_be_off else np.maximum(colors, 0), choices)
            if self.may_be_off:
                wanted[colors == DARK, -1] = 1.0
            colors = self.nearest_colors(wanted)
        lit = (design.colors != DARK)[:, None]
        drive = one_led(colors, len(self.led_power)) * self.led_power * lit
        return Design(self.nearest_directions(design.phi), drive, self.palette)

    def dimmed(self, design: Design) -> Design:
        """Return ``design`` with no LED above its limit and nothing else changed."""
        return replace(design, drive=np.minimum(design.drive, self.led_power))


def _unfulfilled() -> DesignError:
    return DesignError(
        "no choice of colors fulfills the constraints: fix fewer fibers or allow more LEDs "
        "per color",
        field="constraints",
    )


def unlimited(fibers: int, palette: Palette = RGB, *, off: bool = False) -> SearchLimits:
    """Return the limits that allow every color of ``palette``, and ``off`` if that is a choice."""
    choices = len(palette.names) + off
    return SearchLimits(
        allowed=np.ones((fibers, choices), dtype=bool),
        led_counts=np.full(choices, fibers, dtype=np.int64),
        led_power=np.ones(len(palette.names)),
        low=np.zeros((fibers, 1)),
        high=np.full((fibers, 1), math.pi),
        step=0.0,
        continuous_power=False,
        palette=palette,
    )


def turning_limits(scene: Scene) -> SearchLimits:
    """Return the limits that allow every color, and every direction of the lamps that turn."""
    turning, straight = np.array(scene.turning), math.pi / 2
    low, high = (np.where(turning, end, straight)[:, None] for end in (0.0, math.pi))
    return replace(unlimited(scene.lamp_count, scene.palette), low=low, high=high)


def limits_of(scene: Scene) -> SearchLimits:
    """Return the limits that the scene sets: lamps that do not turn, and its constraints.

    Raises:
        DesignError: the constraints contradict each other.
    """
    fibers, given, palette = scene.lamp_count, scene.constraints, scene.palette
    most_lit = scene.search.lamps if scene.search is not None else None
    mirror = scene.search.mirror if scene.search is not None else None
    straight = math.pi / 2
    if given is None and most_lit is None and mirror is None:
        return replace(turning_limits(scene), holder=FiberHolder.of(scene))
    given = given or Constraints()
    may_be_off = bool(given.off) or (most_lit is not None and most_lit < fibers)
    pairs = images(scene.placed_lamps(), mirror) if mirror is not None else ()
    alone = np.array([image is None for image in pairs], dtype=bool)
    some_off = may_be_off or bool(alone.any()) or any(entry.color == OFF for entry in given.fixed)
    free = unlimited(fibers, palette, off=some_off)
    allowed = free.allowed.copy()
    if some_off and not may_be_off:
        allowed[:, -1] = False
    if alone.any():
        allowed[alone] = np.arange(allowed.shape[1]) == len(palette.names)
    for entry in given.fixed:
        if entry.color is not None:
            choices, wanted = np.arange(allowed.shape[1]), palette.index(entry.color)
            allowed[entry.fiber] = free.colors_of(choices) == wanted
    intervals = [
        given.intervals(fiber) if turns else [(straight, straight)]
        for fiber, turns in enumerate(scene.turning)
    ]
    size = max(map(len, intervals))
    padded = np.array([part + part[-1:] * (size - len(part)) for part in intervals])
    led_counts = free.led_counts.copy()
    led_counts[: len(palette.names)] = given.max_counts(palette, fibers)
    limits = replace(
        free,
        allowed=allowed,
        led_counts=led_counts,
        led_power=np.array([given.of_color(name).power for name in palette.names]),
        low=padded[..., 0],
        high=padded[..., 1],
        step=given.angle_step or 0.0,
        continuous_power=given.continuous_power,
        holder=FiberHolder.of(scene),
        most_lit=most_lit,
        ties=_tied(pairs) if mirror is not None else None,
    )
    limits.nearest_colors(np.zeros(allowed.shape))
    limits.nearest_directions(np.full(fibers, math.pi / 2))
    return limits


def _tied(pairs: Sequence[int | None]) -> Colors:
    """Return the group ``(F,)`` of each fiber with its image, in the order of their first."""
    first = [i if other is None else min(i, other) for i, other in enumerate(pairs)]
    return np.unique(first, return_inverse=True)[1]


def dimmed_baseline(scene: Scene) -> Design:
    """Return the design to beat (thesis 5.1), with no LED above what the scene allows."""
    return limits_of(scene).dimmed(baseline_design(scene))
