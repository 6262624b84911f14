"""Edits of a scene file's content: a key by its path, a value in the units of the file."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from render.arguments import refuse
from render.errors import SceneError
from render.scene.lamp_profile import ANGLES, HalfAngle, Profile
from render.scene.quantities import quantities_of
from render.scene.schema.newer_keys import HALF_ANGLE, Place, keys_at, part_at

SOURCE = "changed in Python"
"""What a changed value has as its source where it names none."""


def edited(content: Mapping[str, Any], changes: Mapping[Place, Any]) -> dict[str, Any]:
    """Return the content of a scene file with other values at some places.

    Raises:
        SceneError: a place leads through something that is no table and no list.
    """
    changed = copy.deepcopy(dict(content))
    for place, value in changes.items():
        _put(changed, place, value)
    return changed


def path_of(content: Mapping[str, Any], key: str) -> Place:
    """Return the path that a key means: split at its dots, or else where tables' names end.

    Without a path of that spelling it is what the file would be refused for.

    Raises:
        SceneError: several paths are spelled so.
    """
    if "." in key:
        return tuple(int(step) if step.isdecimal() else step for step in key.split("."))
    found = list(_spelled(content, (), key))
    if len(found) > 1:
        shown = ", ".join(map(_key, found))
        raise SceneError(f"{key} may be {shown}: write it with dots", field=key)
    if found:
        return found[0]
    table = max((name for name in keys_at(()) if key.startswith(f"{name}_")), key=len, default="")
    return (table, key[len(table) + 1 :]) if table and part_at((table,)) else (key,)


def _spelled(content: Any, place: Place, key: str) -> Iterator[Place]:
    """Yield the paths at or below a place whose steps are ``key`` when joined by underscores."""
    steps: list[Any] = [*keys_at(place)]
    if isinstance(content, list):
        steps = [*range(len(content))]
    elif isinstance(content, dict):
        steps += [name for name in content if name not in steps]
    for step in steps:
        if key == str(step):
            yield (*place, step)
        elif key.startswith(f"{step}_"):
            inside = isinstance(content, list) or (isinstance(content, dict) and step in content)
            yield from _spelled(
                content[step] if inside else None, (*place, step), key[len(str(step)) + 1 :]
            )


def _put(content: dict[str, Any], place: Place, value: Any) -> None:
    """Change the value at one place of a file's ``content``."""
    table: Any = content
    for number in range(1, len(place)):
        table = _opened(table, place[:number])
    step = place[-1]
    old = table.get(step) if isinstance(table, dict) else table[_index(table, place)]
    if step in ANGLES and isinstance(table, dict):  # a beam has one of them
        table.pop(ANGLES[1 - ANGLES.index(str(step))], None)
    if value is None and isinstance(table, dict):
        table.pop(step, None)
    elif isinstance(value, Mapping) and isinstance(old, dict) and part_at(place) is not Profile:
        for name, part in value.items():
            _put(content, (*place, name), part)
    else:  # of a profile's keys only one is there
        table[step] = _written(place, value)


def _opened(table: Any, place: Place) -> Any:
    """Return the table or the list at a ``place`` in its ``table``, a new one where it has none."""
    if isinstance(table, list):
        return table[_index(table, place)]
    inside = table.get(place[-1])
    if not isinstance(inside, dict | list):
        if inside is not None and part_at(place) is None:
            raise SceneError(
                f"{_key(place)} is no table, allowed: {_key(place)} itself", field=_key(place)
            )
        inside = table[place[-1]] = {}
    return inside


def _index(entries: list[Any], place: Place) -> int:
    """Return the number that the last step of a ``place`` is of a list."""
    step = place[-1]
    if isinstance(step, int) and step < len(entries):
        return step
    name = _key(place[:-1])
    numbers = f"{name}.0" + (f" to {name}.{len(entries) - 1}" if len(entries) > 1 else "")
    raise SceneError(
        f"{_key(place)} is no entry of a list, allowed: {numbers}, or {name} as a whole list",
        field=_key(place),
    )


def _written(place: Place, value: Any) -> Any:
    """Return a value for a ``place`` as its file has it: a plain number with unit and source."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    value = str(value) if isinstance(value, PurePath) else value
    if not isinstance(value, str | bool | int | float | list | tuple | Mapping | None):
        refuse(value, _key(place), "values as the file has them", SceneError)
    if isinstance(value, Mapping):
        inside = {name: _written((*place, name), part) for name, part in value.items()}
        return {name: part for name, part in inside.items() if part is not None}
    part, name = part_at(place[:-1]), place[-1]
    part = HalfAngle if name == HALF_ANGLE else part
    quantity = next(quantities_of(part, str(name)), None) if part is not None else None
    if isinstance(value, list | tuple):
        value = [_written((*place, number), item) for number, item in enumerate(value)]
    return value if quantity is None else quantity.form(value, SOURCE)


def _key(place: Place) -> str:
    return ".".join(map(str, place))
