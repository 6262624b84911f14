"""What a search may choose: the builder's constraints as arrays, and how candidates obey them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optimize.design.design import DARK, Array, Colors, Design, baseline_design, one_led
from optimize.design.linear_rules import Budget, LinearRules
from optimize.design.part_limits import (
    budgets_of,
    counted_limits,
    overlapping,
    part_choices,
    searched_parts,
)
from optimize.design.runs import Runs, around_rim
from optimize.design.tied_directions import TiedDirections
from render.errors import DesignError
from render.geometry import FiberHolder
from render.scene import OFF, RGB, Constraints, Palette, Scene
from render.scene.places import images

TURNS = 16
"""Steps in which fibers that would meet are turned upright."""


@dataclass(frozen=True, eq=False)
class SearchLimits:
    """SearchLimits of a search.

    Arguments:
        allowed: ``(F, choice)`` which colors each fiber may have; the last choice is off where
            that is one.
        led_counts: ``(LED,)`` how many there are of each type, which is the most fibers that may
            have one, in whatever shots; last, where off is a choice, those that may be off.
        led_power: ``(color,)`` power of an LED that is on.
        low, high: ``(F, interval)`` rad, allowed directions; unused intervals repeat the last.
        step: rad between directions, counted from 0; 0 for none. Fixed directions need not fit.
        continuous_power: whether fibers may have less than ``led_power``.
        holder: in which neighboring fibers must not meet; None where nothing holds them.
        most_lit: fibers that may be lit at once; None is all.
        exclusive: ``(F, F)`` fibers of which at most one may be lit; None where all may.
        budgets: what lit fibers may cost together.
        runs: of one color along the ring that there may be; None is any number.
        ties: ``(F,)`` group of each fiber, 0..G-1, whose fibers have one color or are all off;
            None where each is alone.
        tied: directions of mirror images; None where each lamp turns by itself.
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
    exclusive: NDArray[np.bool_] | None = None
    budgets: tuple[Budget, ...] = ()
    runs: Runs | None = None
    ties: Colors | None = None
    tied: TiedDirections | None = None

    @cached_property
    def rules(self) -> LinearRules:
        """All that limits colors beside ``allowed``."""
        return LinearRules.of(
            self.led,
            self.led_counts,
            len(self.allowed),
            len(self.palette.names),
            self.most_lit,
            self.exclusive,
            self.budgets,
        )

    @cached_property
    def groups(self) -> Colors:
        """``(F,)`` group of each fiber: that of `ties`, or its own."""
        return np.arange(len(self.allowed)) if self.ties is None else self.ties

    @cached_property
    def of_groups(self) -> tuple[NDArray[np.bool_], LinearRules]:
        """Which choices ``(G, choice)`` whole groups may have, and what limits these."""
        allowed = np.ones((int(self.groups.max()) + 1, self.allowed.shape[1]), dtype=bool)
        np.logical_and.at(allowed, self.groups, self.allowed)
        return allowed, self.rules.of_groups(self.groups)

    @cached_property
    def directions(self) -> TiedDirections:
        """Which fiber's direction each one's follows."""
        return self.tied or TiedDirections.none(len(self.allowed))

    @property
    def turned(self) -> NDArray[np.bool_]:
        """``(F,)`` fibers whose direction a search chooses."""
        return ~self.fixed_directions & self.directions.leads

    @property
    def may_be_off(self) -> bool:
        """Whether off is a choice."""
        return bool(self.allowed.shape[1] > len(self.palette.names))

    @property
    def colors_limited(self) -> bool:
        """Whether some coloring is not allowed."""
        limited = self.runs_limited or self.ties is not None
        return bool(not self.allowed.all() or len(self.rules.most) or limited)

    @property
    def some_stay_off(self) -> bool:
        """Whether fewer fibers may be lit than there are."""
        return self.most_lit is not None and self.most_lit < len(self.allowed)

    @property
    def runs_limited(self) -> bool:
        """Whether some coloring has too many runs."""
        return self.runs is not None and self.runs.most < len(self.allowed)

    @property
    def words(self) -> str:
        """What colorings are searched, in words that follow *designs*; empty where all are.

        >>> from dataclasses import replace
        >>> replace(unlimited(9, off=True), most_lit=2).words
        ' with at most 2 of 9 lamps lit'
        """
        parts = []
        if self.some_stay_off:
            parts.append(f"at most {self.most_lit} of {len(self.allowed)} lamps lit")
        if self.runs is not None and self.runs_limited:
            most = self.runs.most
            parts.append(f"at most {most} run{'s' * (most != 1)} of one color")
        return f" with {' and '.join(parts)}" if parts else ""

    @property
    def colors_alike(self) -> bool:
        """Whether exchanging two colors in all fibers keeps every coloring allowed."""
        counts = self.led_counts[: self.palette.led_count]
        return bool(self.allowed.all() and (counts == counts[0]).all() and not self.budgets)

    @property
    def fixed_directions(self) -> NDArray[np.bool_]:
        """``(F,)`` fibers whose direction is fixed."""
        return np.asarray(self.low[:, 0] == self.high[:, -1])

    @property
    def directions_limited(self) -> bool:
        """Whether some direction is not allowed."""
        whole = (self.low[:, 0] == 0.0) & (self.high[:, -1] == math.pi)
        limited = self.low.shape[1] > 1 or not whole.all() or self.step > 0.0
        return bool(limited or self.tied is not None)

    def fits(self, colors: Colors) -> NDArray[np.bool_]:
        """Return which of ``colors`` ``(N, F)`` are allowed; -1 is off."""
        chosen = np.asarray(colors)
        permitted = self.allowed[np.arange(chosen.shape[1]), chosen].all(axis=1)
        if not self.may_be_off:
            permitted &= (chosen != DARK).all(axis=1)
        # Where off is no choice it has no weight, and is not permitted.
        permitted &= self.rules.fit(chosen)
        if self.runs is not None:
            permitted &= self.runs.fit(chosen)
        if self.ties is not None:
            first = np.unique(self.ties, return_index=True)[1]
            permitted &= (chosen == chosen[:, first[self.ties]]).all(axis=1)
        return np.asarray(permitted)

    @property
    def led(self) -> Colors:
        """What of ``led_counts`` each choice takes one of, ``(choice,)``."""
        off = [self.palette.led_count] * self.may_be_off
        return np.append(self.palette.led, off).astype(np.int64)

    def nearest_colors(self, preference: Array) -> Colors:
        """Return the allowed colors ``(F,)`` of greatest total ``preference`` ``(F, choice)``.

        Where runs are limited it is near the best.

        Raises:
            DesignError: no coloring is allowed.
        """
        allowed, rules = self.of_groups
        worth = np.zeros(allowed.shape)
        np.add.at(worth, self.groups, preference)
        if self.runs is not None and self.runs_limited:
            value = np.where(allowed, worth, -np.inf)
            choices = self.runs.nearest(value, rules, len(self.palette.names), self.groups)
            if choices is None:
                raise DesignError(
                    f"no choice of colors in at most {self.runs.most} runs fulfills the "
                    "constraints: allow more runs, fix fewer fibers or allow more LEDs per color",
                    field="search.runs",
                )
            return self.colors_of(choices[self.groups])
        choices = rules.best_choice(worth, allowed)
        if choices is not None:
            return self.colors_of(choices[self.groups])
        counted = any(one.key.startswith("search.counts") for one in self.budgets)
        keys = dict.fromkeys(one.key for one in self.budgets if "counts" not in one.key)
        raise DesignError(
            "no choice of colors fulfills the constraints: fix fewer fibers or allow more "
            f"{' or more of '.join(['LEDs per color', *keys])}"
            f"{', or say less in search.counts' * counted}",
            field="constraints",
        )

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
        while (crowded := self.directions.with_images(self.holder.crowded(turned))).any():
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
        phi = self.directions.mirrored(phi)
        ends = np.clip(phi[..., None], self.low, self.high)
        if self.step > 0.0:
            # A step may lie outside its interval at an end; then the next one inside is taken.
            lowest = np.ceil(self.low / self.step - 1e-9) * self.step
            highest = np.floor(self.high / self.step + 1e-9) * self.step
            on_step = np.clip(np.round(ends / self.step) * self.step, lowest, highest)
            on_step = np.where(lowest > highest, np.inf, np.minimum(on_step, math.pi))
            ends = np.where(self.fixed_directions[:, None], ends, on_step)
        nearest = np.abs(ends - phi[..., None]).argmin(axis=-1)
        return self.directions.mirrored(
            np.take_along_axis(ends, nearest[..., None], axis=-1)[..., 0]
        )

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
            if self.exclusive is not None:
                wanted[:, : len(self.palette.names)] += self._in_place_of(colors)
            colors = self.nearest_colors(wanted)
        lit = ((colors if self.may_be_off else design.colors) != DARK)[:, None]
        drive = one_led(colors, len(self.led_power)) * self.led_power * lit
        return Design(self.nearest_directions(design.phi), drive, self.palette)

    def _in_place_of(self, colors: Colors) -> Array:
        """Return how gladly a fiber takes a color ``(F, color)`` for an overlapping one.

        Twice the cosine between what the camera sees of both, so that hue decides, and a lit one
        is taken before a dark one.
        """
        assert self.exclusive is not None
        seen = self.palette.matrix
        seen = seen / np.linalg.norm(seen, axis=1, keepdims=True)
        alike = np.where((colors == DARK)[:, None], 0.0, (seen @ seen.T)[colors])
        return np.asarray(2.0 * np.where(self.exclusive[..., None], alike, 0.0).max(axis=1))

    def dimmed(self, design: Design) -> Design:
        """Return ``design`` with no LED above its limit and nothing else changed."""
        return replace(design, drive=np.minimum(design.drive, self.led_power))


def unlimited(fibers: int, palette: Palette = RGB, *, off: bool = False) -> SearchLimits:
    """Return the limits that allow every color of ``palette``, and ``off`` if that is a choice."""
    choices = len(palette.names) + off
    return SearchLimits(
        allowed=np.ones((fibers, choices), dtype=bool),
        led_counts=np.full(palette.led_count + off, fibers, dtype=np.int64),
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
    most_runs = scene.search.runs if scene.search is not None else None
    mirror = scene.search.mirror if scene.search is not None else None
    straight = math.pi / 2
    parts = searched_parts(scene)
    draws = scene.search is not None and scene.search.current is not None
    counts = bool(scene.search and scene.search.counts)
    asked = most_lit is not None or most_runs is not None or mirror is not None or counts
    if given is None and not asked and not parts and not draws:
        return replace(turning_limits(scene), holder=FiberHolder.of(scene))
    given = given or Constraints()
    may_be_off = bool(given.off) or (most_lit is not None and most_lit < fibers)
    may_be_off = may_be_off or bool(parts) or draws
    pairs = images(scene.placed_lamps(), mirror) if mirror is not None else ()
    alone = np.array([image is None for image in pairs], dtype=bool)
    some_off = may_be_off or bool(alone.any()) or any(entry.color == OFF for entry in given.fixed)
    free = unlimited(fibers, palette, off=some_off)
    allowed = free.allowed.copy()
    if some_off and not may_be_off:
        allowed[:, -1] = False
    if parts:
        allowed[:, : len(palette.names)] = part_choices(scene)
    near = overlapping(scene, allowed[:, : len(palette.names)] & bool(parts))
    exclusive = near if near.any() else None
    if alone.any():
        allowed[alone] = np.arange(allowed.shape[1]) == len(palette.names)
    for entry in given.fixed:
        if entry.color is not None:
            # A fixed lamp has its LED, which may shine in any of the shots.
            wanted = palette.index(entry.color) % len(free.led_counts)
            allowed[entry.fiber] = free.led == wanted
    intervals = [
        given.intervals(fiber) if turns else [(straight, straight)]
        for fiber, turns in enumerate(scene.turning)
    ]
    tied = None
    if mirror is not None and any(scene.turning):
        tied = TiedDirections.of(scene, pairs, mirror)
        intervals = tied.allowed(intervals, given.angle_step)
    size = max(map(len, intervals))
    padded = np.array([part + part[-1:] * (size - len(part)) for part in intervals])
    led_counts = free.led_counts.copy()
    led_counts[: palette.led_count] = given.max_counts(palette.one_shot, fibers)
    led_power = np.array([given.of_color(name).power for name in palette.one_shot.names])
    led_counts, counted = counted_limits(scene, free.led, led_counts, allowed)
    limits = replace(
        free,
        allowed=allowed,
        led_counts=led_counts,
        led_power=led_power[palette.led],
        low=padded[..., 0],
        high=padded[..., 1],
        step=given.angle_step or 0.0,
        continuous_power=given.continuous_power,
        holder=FiberHolder.of(scene),
        most_lit=most_lit,
        exclusive=exclusive,
        budgets=(*counted, *budgets_of(scene, led_power, allowed)),
        runs=None if most_runs is None else Runs(most_runs, around_rim(scene, pairs or None)),
        ties=_tied(pairs) if mirror is not None else None,
        tied=tied,
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
