"""Lamps that may be parts: one on every place for each body that parts have, and their colors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import tomlkit

from optimize.design import DARK, Array, Design, currents, prices
from optimize.exploration import Exploration
from render.errors import SceneError
from render.scene import RGB, Led, LedEntry, Profile, Scene, entries_of, known_leds, responses
from render.scene.catalog import naming_problems
from render.scene.lamps import ListedLamp, placed_lamps
from render.scene.places import CandidateLamp, lamp_problems
from render.scene.schema.toml_document import lamp_table

INKS = (
    (490.0, "#2f5fd0"),
    (570.0, "#1e9e4a"),
    (605.0, "#b9770e"),
    (700.0, "#d1352b"),
    (math.inf, "#7a4a4a"),
)
"""What reports draw parts with, by wavelength below, nm."""
WHITE_INK = "#5d6d7e"
DIGITS = 6
"""Of what a channel sees of a part."""


@dataclass(frozen=True, eq=False)
class _Place:
    """Where a lamp may be; ``own`` is the number of the lamp that is there already."""

    position: Array
    direction: Array
    turns: bool
    said: str
    own: int | None = None


def named_leds(scene: Scene, names: Sequence[str], option: str = "") -> list[Led]:
    """Return the LEDs of these names, all of which the scene's camera sees.

    Raises:
        SceneError: a name is none of a part, or unfit for the camera's channels.
    """
    key = "parts" if option else "search.parts"
    own = scene.parts or ()
    for problem in naming_problems(names, own, scene.palette.one_shot.channels, key):
        raise SceneError(problem, field=key, option=option)
    known = known_leds(own)
    return [known[name] for name in names]


def part_lamps(
    scene: Scene, leds: Sequence[Led], candidates: Sequence[CandidateLamp], option: str = ""
) -> list[dict[str, Any]]:
    """Return the lamps to list: on each place one for every body that parts have and that fits.

    The scene's own places come first; where its own lamp has such a body it is that lamp.

    Raises:
        SceneError: a part fits on no place.
    """
    placed = scene.placed_lamps()
    bodies: dict[tuple[float, float], Led] = {}
    for led in leds:
        bodies.setdefault(led.body, led)
    fits = dict.fromkeys(bodies, 0)
    why: dict[tuple[float, float], str] = {}
    found = []
    for place in _places(scene, candidates):
        for body, led in bodies.items():
            own = None if place.own is None else placed[place.own]
            if own is not None and led.is_body_of(own.diameter, own.profile):
                fits[body] += 1
                continue
            problem = next(_misfits(scene, place, led), None)
            if problem is None:
                fits[body] += 1
                found.append(_lamp(place, led))
            else:
                why.setdefault(body, problem)
    for body, led in bodies.items():
        if not fits[body]:
            raise SceneError(
                f"{'parts' if option else 'search.parts'} = {led.name} fits on no place of "
                f"{scene.name}: {why[body]}",
                field="search.parts",
                option=option,
            )
    return found


def list_colors(document: tomlkit.TOMLDocument, scene: Scene, leds: Sequence[Led]) -> None:
    """Add a color for every entry of ``leds`` to the palette, as bright as it is."""
    colors = document.get("colors")
    if colors is None:
        colors = tomlkit.aot()
        for name, seen in zip(RGB.names, RGB.response, strict=True):
            response = {"value": list(seen), "source": "a scene without colors"}
            colors.append(lamp_table({"name": name, "response": response}))
    entries = [entry for led in leds for entry in entries_of(led)]
    names = {entry.name for entry in entries}
    kept = [color for color in colors if color["name"] not in names]
    tables = tomlkit.aot()
    for color in kept:
        tables.append(color)
    for entry, seen in zip(
        entries, responses(entries, scene.palette.one_shot.channels), strict=True
    ):
        tables.append(lamp_table(_color(entry, seen)))
    document["colors"] = tables


def parts_sentence(found: Exploration) -> str:
    """Return which parts a design has, what they draw and cost, and whether ideal LEDs do more."""
    first, last, objective = found.stages[0], found.stages[-1], found.objective
    said = parts_drawn(found.scene, last.design)
    if objective == "score" or last.error(objective) <= first.error(objective):
        return said
    return (
        f"{said} The baseline reads better: its LEDs are as the scene draws them, none of these "
        "parts."
    )


def parts_drawn(scene: Scene, design: Design) -> str:
    """Return which parts a design has, what they draw together, and what they cost."""
    palette, colors = design.palette, design.colors
    lit = palette.led[colors[colors != DARK]]
    names = palette.one_shot.names
    counted = [f"{(lit == led).sum()} {names[led]}" for led in np.unique(lit)]
    drawn = (palette.in_shots(design.drive) @ currents(scene)).sum(axis=1).max()
    cost = float(prices(scene)[lit].sum())
    price = "" if math.isnan(cost) else f", about {cost:.2f} US dollars"
    return f"Parts: {', '.join(counted)}; {drawn:.0f} mA together{price}."


def _color(entry: LedEntry, seen: Array) -> dict[str, Any]:
    die = entry.die
    source = f"{entry.led.name} at {die.ma:g} mA, over the brightest of the search's parts"
    ink = WHITE_INK if die.phosphor else next(ink for below, ink in INKS if (die.nm or 0.0) < below)
    values = [float(f"{value:.{DIGITS}g}") for value in seen]
    return {"name": entry.name, "response": {"value": values, "source": source}, "ink": ink}


def _places(scene: Scene, candidates: Sequence[CandidateLamp]) -> Iterator[_Place]:
    for number, lamp in enumerate(scene.placed_lamps()):
        yield _Place(lamp.position, lamp.beam, lamp.turns, f"the place of lamp {number}", number)
    placed = scene.placed_lamps()
    for one in candidates:
        turns = placed[one.like].turns
        yield _Place(one.position, one.direction, turns, one.words)


def _misfits(scene: Scene, place: _Place, led: Led) -> Iterator[str]:
    """Yield why an LED cannot be on a place."""
    half, height, box = led.body_mm[1] / 2, float(place.position[2]), scene.box
    above, below = float(box.high[2]), float(box.low[2])
    beside = bool((box.distance(place.position)[:4] > 0.0).any())
    if beside and led.body_mm[1] > above - below:
        yield f"it is {led.body_mm[1]:g} mm high, allowed: at most the edge of {above - below:g} mm"
    elif beside and not below <= height - half <= height + half <= above:
        room = 2.0 * min(above - height, height - below)
        yield (
            f"it is {led.body_mm[1]:g} mm high and centered at z = {height:g} mm, allowed: at most "
            f"{room:g} mm there, or heights in the middle of the edge"
        )
    profile = Profile.model_construct(cosine_exponent=led.exponent)
    listed = ListedLamp.model_construct(
        position=tuple(place.position),
        direction=tuple(place.direction),
        diameter=led.diameter,
        profile=profile,
        turns=place.turns,
    )
    for problem in lamp_problems(scene, placed_lamps(scene.box, (), (listed,), False)[0]):
        yield problem.replace("lamps.0", "a lamp", 1)


def _lamp(place: _Place, led: Led) -> dict[str, Any]:
    source = f"searched: {place.said}, for {led.name} and parts with the same body"
    sheet = f"{led.name}: {led.source}"
    profile: Any = "lambertian"
    if led.exponent != 1.0:
        profile = {"cosine_exponent": {"value": led.exponent, "source": sheet}}
    return {
        "position": {"value": _plain(place.position), "unit": "mm", "source": source},
        "direction": {"value": _plain(place.direction), "source": source},
        "diameter": {"value": led.diameter, "unit": "mm", "source": sheet},
        "profile": profile,
        "turns": place.turns,
    }


def _plain(vector: Array) -> list[float]:
    return [float(value) + 0.0 for value in vector]
