"""Which lamp may be which part, which bodies overlap, what lit lamps draw and cost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from optimize.design.design import Array, Colors
from optimize.design.linear_rules import Budget
from render.errors import DesignError
from render.scene import OFF, LampCount, LedEntry, Scene, entries_in, entries_of, known_leds

FULL_MILLIAMPERES = 20.0
"""Of an LED that is no known part, at full power."""
TOUCHING = 1e-6
"""mm by which bodies may overlap by rounding."""


def part_entries(scene: Scene) -> tuple[LedEntry | None, ...]:
    """Return which part every LED of a scene is; None: no known one."""
    return entries_in(scene.palette.one_shot, scene.parts or ())


def searched_parts(scene: Scene) -> tuple[str, ...]:
    """Return the LEDs that are parts of the scene's search; none where it lists none of them."""
    if scene.search is None:
        return ()
    known = known_leds(scene.parts or ())
    entries = [entry.name for name in scene.search.parts for entry in entries_of(known[name])]
    return tuple(name for name in entries if name in scene.palette.one_shot.names)


def counted_leds(scene: Scene, count: LampCount) -> list[int]:
    """Return the numbers of the LEDs that ``count`` is of; parts that are not placed are none."""
    known, names = known_leds(scene.parts or ()), scene.palette.one_shot.names
    asked = {
        entry.name
        for name in count.of
        for entry in (entries_of(known[name]) if name in known else ())
    }
    return [led for led, name in enumerate(names) if name in asked or name in count.of]


def counted_limits(
    scene: Scene, led: Colors, led_counts: Colors, allowed: NDArray[np.bool_]
) -> tuple[Colors, tuple[Budget, ...]]:
    """Return how many LEDs of each type there are, and the budgets that ``[[search.counts]]`` are.

    Arguments:
        scene: whose search counts.
        led: ``(choice,)`` the LED of each choice, off among them.
        led_counts: ``(LED,)`` how many there are without it.
        allowed: ``(F, choice)`` what lamps may be.

    At least so many of some are at most so many of all others, off included.

    Raises:
        DesignError: fewer lamps may be one of them than there shall be.
    """
    led_counts, found, fibers = led_counts.copy(), [], len(allowed)
    for number, count in enumerate(scene.search.counts if scene.search is not None else ()):
        leds, key = counted_leds(scene, count), f"search.counts.{number}"
        if not leds:
            continue
        of_them = np.isin(led, leds)
        room = int(allowed[:, of_them].any(axis=1).sum())
        if count.exactly is not None and count.exactly > room:
            raise DesignError(
                f"{key} asks for {count.words}, but {room} lamps may be one, allowed: at most "
                f"{room}",
                field=key,
            )
        each = np.tile(of_them, (fibers, 1)).astype(np.float64)
        if len(leds) == 1:
            led_counts[leds] = np.minimum(led_counts[leds], count.most)
        else:
            found.append(Budget(key, each, count.most))
        if count.exactly is not None:
            found.append(Budget(key, 1.0 - each, fibers - count.exactly))
    return led_counts, tuple(found)


def part_choices(scene: Scene) -> NDArray[np.bool_]:
    """Return which colors ``(F, color)`` each lamp may have: those of parts with its body."""
    names, lamps = searched_parts(scene), scene.placed_lamps()
    of_leds = np.array(
        [
            [
                entry is not None
                and entry.name in names
                and entry.led.is_body_of(lamp.diameter, lamp.profile)
                for entry in part_entries(scene)
            ]
            for lamp in lamps
        ]
    )
    return np.asarray(of_leds[:, scene.palette.led])


def overlapping(scene: Scene, choices: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which lamps ``(F, F)`` are too near to be lit together.

    Bodies may not overlap: a lamp is as wide as the widest part that it may be, by ``choices``
    ``(F, color)``, or else as it is drawn. Lamps that are no parts keep `Search.apart` where the
    search says so. What the baseline lights may be lit together.
    """
    lamps = scene.placed_lamps()
    widths = np.array([0.0 if one is None else one.led.body_mm[0] for one in part_entries(scene)])
    widths = widths[scene.palette.led]
    widest = np.where(choices, widths, 0.0).max(axis=1)
    width = np.where(choices.any(axis=1), widest, [lamp.diameter for lamp in lamps])
    place = np.array([lamp.position for lamp in lamps])
    least = (width[:, None] + width[None]) / 2
    if scene.search is not None and scene.search.apart is not None and not choices.any():
        least = np.full_like(least, scene.search.apart)
    near = np.linalg.norm(place[:, None] - place[None], axis=2) < least - TOUCHING
    built = np.array([color != OFF for color in scene.baseline_colors()])
    return np.asarray(near & ~(built[:, None] & built) & ~np.eye(len(lamps), dtype=bool))


def currents(scene: Scene) -> Array:
    """Return what each LED draws at full power, mA, ``(LED,)``."""
    return np.array(
        [FULL_MILLIAMPERES if one is None else one.die.ma for one in part_entries(scene)]
    )


def prices(scene: Scene) -> Array:
    """Return what each LED costs, US dollars, ``(LED,)``; NaN where nobody says."""
    return np.array(
        [
            np.nan if one is None or one.led.usd is None else one.led.usd
            for one in part_entries(scene)
        ]
    )


def budgets_of(scene: Scene, power: Array, allowed: NDArray[np.bool_]) -> tuple[Budget, ...]:
    """Return what the search of a scene lets lamps draw and cost together.

    ``power`` ``(LED,)`` is that of one that is on, ``allowed`` ``(F, choice)`` what lamps may
    be.

    Raises:
        DesignError: no lamp may be lit, or a part has no price.
    """
    search, palette = scene.search, scene.palette
    if search is None:
        return ()
    colors = len(palette.names)
    shining = palette.in_shots(np.eye(colors)).sum(axis=2)
    found = []
    draws, costs = (currents(scene) * power)[palette.led], prices(scene)[palette.led]
    # Every shot by itself keeps to the current; a part is bought once.
    asked = (
        *(("search.current", search.current, draws * shot, "mA") for shot in shining),
        ("search.price", search.price, costs, "US dollars"),
    )
    choosable = allowed[:, :colors].any(axis=0)
    for key, limit, each, unit in asked:
        if limit is None:
            continue
        if not searched_parts(scene) and key == "search.price":
            continue
        unknown = [palette.names[c] for c in np.flatnonzero(choosable & np.isnan(each))]
        if unknown:
            raise DesignError(
                f"{key}: {unknown[0]} has no price, allowed: parts that have one (usd)", field=key
            )
        least = each[choosable & (each > 0.0)].min(initial=np.inf)
        if least > limit:
            raise DesignError(
                f"{key} = {limit:g} {unit}, but no lamp takes less than {least:g} {unit}, allowed: "
                f"at least {least:g}",
                field=key,
            )
        cost = np.zeros(allowed.shape)
        cost[:, :colors] = np.nan_to_num(each)
        found.append(Budget(key, cost, limit))
    return tuple(found)
