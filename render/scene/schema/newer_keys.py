"""What a scene file is told that asks for what it cannot say, and a file of schema 2 can.

A file of schema 1 has fibers on three edges that shine in red, green and blue. Whoever writes more
into one has read of it somewhere: what is refused then says what would be right.
"""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

from render.scene.colors import OFF
from render.scene.lamps import EDGES, Fibers, Row
from render.scene.quantities import Part, allowed_range, quantities_of
from render.scene.schema.scene import Scene
from render.scene.serialization import part_class
from render.scene.tolerances import Tolerances

Place = tuple[int | str, ...]
LAMPS_FILE, HALF_ANGLE = "lamps_file", "half_angle"
"""Keys of a file that stand for ``lamps`` and ``sigma_v``."""


def part_at(place: Place) -> type[Part] | None:
    """Return the class of the part at a ``place`` of a scene file, None where none is known."""
    part: type[Part] = Scene
    try:
        for step in place:
            if isinstance(step, str):
                part = part_class(part.model_fields[step].annotation)
    except (KeyError, TypeError):
        return None
    return part


def keys_at(place: Place) -> dict[str, bool]:
    """Return the keys of the part at a ``place`` of a scene file, and which need schema 2.

    There are none where no part is known.
    """
    part, found = part_at(place), {}
    if part is None:
        return {}
    for name, field in part.model_fields.items():
        if name != "carried":
            extra = field.json_schema_extra
            newer = isinstance(extra, dict) and extra.get("since_schema") == 2
            found[field.alias or name] = newer
            if part is Scene and name == "lamps":
                found[LAMPS_FILE] = newer
            if name == "sigma_v" and part is not Tolerances:
                found[HALF_ANGLE] = newer
    return found


def instead_of_key(place: Place, raw: Mapping[str, Any]) -> str:
    """Return what a file may hold in place of an unknown key: the nearest, or all there are."""
    known, key = keys_at(place[:-1]), str(place[-1])
    old = raw.get("schema") == 1
    near = get_close_matches(key, known, n=1, cutoff=0.7)
    if near:
        which = ", which needs schema = 2" if old and known[near[0]] else ""
        return f", did you mean {near[0]}{which}?"
    allowed = ", ".join(name for name, newer in known.items() if not (old and newer))
    newer = ", ".join(name for name, newer in known.items() if old and newer)
    hints = [f"with schema = 2 also {newer}"] if newer else []
    if place[:-1] == ("fibers",) and key in EDGES:
        hints.append(f'{_rows(raw)} can have edge = "{key}"')
    elif place[:-1] == ("fibers",) and key in Row.model_fields:
        hints.append(f"{_rows(raw)} have {key}")
    return (f", allowed: {allowed}" if allowed else "") + _in_brackets("; ".join(hints))


def instead_of_value(problem: Any, raw: Mapping[str, Any]) -> str:
    """Return what else a file may hold that has a value which was refused, "" where nothing."""
    place, kind, given = problem["loc"], problem["type"], problem["input"]
    if place[-1:] == ("half_angle",) and kind == "out_of_range":
        return _in_brackets('"lambertian" has 60 deg; some data sheets give twice the angle')
    if kind == "unknown_color" and "colors" not in raw:
        old = raw.get("schema") == 1
        if old and OFF in (given if isinstance(given, list) else [given]):
            return _in_brackets(f"{OFF} needs schema = 2")
        return _in_brackets(f"other LEDs need {'schema = 2 and ' * old}[[colors]] that name them")
    if len(place) != 2 or place[0] != "fibers":
        return ""
    key = str(place[1])
    if isinstance(given, dict):
        given = given.get("value")
    if kind == "out_of_range":
        return _in_brackets(_range_of_rows(key, given, raw))
    if isinstance(given, list) and key in EDGES:
        return _in_brackets(f"{_rows(raw)} can have lamps at places of their own")
    if isinstance(given, list) and key in Row.model_fields:
        return _in_brackets(f"{_rows(raw)} have a {key} each")
    return ""


def _rows(raw: Mapping[str, Any]) -> str:
    return "[[rows]] of schema = 2" if raw.get("schema") == 1 else "[[rows]] in place of fibers"


def _in_brackets(hint: str) -> str:
    return f" ({hint})" if hint else ""


def _range_of_rows(key: str, value: Any, raw: Mapping[str, Any]) -> str:
    """Return the range of a quantity in rows, where a value of fibers lies in it."""
    for row, fiber in zip(quantities_of(Row, key), quantities_of(Fibers, key), strict=False):
        wider = row.low < fiber.low or row.high > fiber.high
        if wider and isinstance(value, int | float) and row.low <= value <= row.high:
            allowed = allowed_range(row.low, row.high, row.unit)
            return f"{_rows(raw)} can have {allowed}"
    return ""
