"""A layout drawn by hand: colors and angles are enough, as JSON or TOML.

A finger of eight fibers::

    scene = "small.toml"              # or --scene; a shipped name, or a file
    colors = "rrrbbggg"               # or ["red", "red", ...]; "-" or "off" for a dark fiber
                                      # (a letter is the first of the scene's only color with it)
    angles_deg = [90, 90, 90, 80, 100, 90, 90, 90]   # or one number for all; none is needed where
                                      # no lamp turns

Fibers are numbered as in the wiring sheet: left from base to tip, tip from left to right, right
from tip to base. The lit LED of a fiber has the full power that the scene allows, unless ``power``
says less, a fraction per fiber. A ``design.json`` of any version is a layout too; its rating is
not read.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from optimize.design.design import Design, one_led
from optimize.design.find_scene import find_scene
from optimize.design.limits import limits_of
from render.errors import DesignError
from render.files import parse_json, parse_toml, read_text
from render.refused_values import did_you_mean, in_json
from render.scene import OFF, Palette, Scene, load_scene

KEYS = ("scene", "scene_hash", "colors", "colours", "angles_deg", "power")
SCORED = ("level", "effort", "score", "read", "lam", "exposure", "conventions")
RATED = ("schema", "palette", "versions", *SCORED)
"""What a design file holds besides."""


def load_layout(path: Path, scene_name: str | None = None) -> tuple[Scene, Design]:
    """Return the scene and the design of the layout in ``path``.

    ``scene_name`` is a shipped scene or a file, instead of what the layout names.

    Raises:
        DesignError: names every problem of the file at once.
        SceneError: the scene cannot be read.
    """
    content = _content(path)
    named = scene_name or content.get("scene")
    if not isinstance(named, str) or not named:
        raise _refusal(path, ['it names no scene: add scene = "..." or give one'],
                       option="--scene")  # fmt: skip
    given = content.get("scene_hash", "")
    found = scene_name or find_scene(named, path, given if isinstance(given, str) else "")
    if found is None:
        problem = f"scene = {in_json(named)} is neither a shipped scene nor a file"
        raise _refusal(path, [f"{problem}: name its TOML file"], option="--scene")
    scene = load_scene(found)
    fibers, problems = scene.lamp_count, []
    known = {*KEYS, *(RATED if "schema" in content else ())}
    problems += [f"unknown key {key}" for key in content if key not in known]
    if content.get("scene_hash", scene.hash) != scene.hash:
        problems.append(
            f"scene_hash = {in_json(content['scene_hash'])}, allowed: {scene.hash} of {scene.name}"
        )
    given = content.get("colors", content.get("colours"))
    colors = _colors(given, fibers, scene.palette, problems)
    given = content.get("angles_deg")
    if given is None and not any(scene.turning):
        given = 90.0
    angles = _angles(given, fibers, problems)
    power = _power(content.get("power"), colors, scene, problems)
    if problems:
        raise _refusal(path, problems)
    return scene, Design(np.minimum(np.radians(angles), math.pi), power, scene.palette)


def _content(path: Path) -> dict[str, Any]:
    try:
        text = read_text(path)
    except ValueError as error:
        raise DesignError(
            f"{path} {error}; give a JSON or TOML file with colors and angles_deg", field="design"
        ) from None
    try:
        if path.suffix == ".toml":
            return parse_toml(text)
        found = parse_json(text)
    except ValueError as error:
        kind = "TOML" if path.suffix == ".toml" else "JSON"
        raise _refusal(path, [f"it is not {kind} ({error})" if text else "it is empty"]) from None
    if not isinstance(found, dict):
        raise _refusal(path, [f"it is {in_json(found)}, allowed: keys colors and angles_deg"])
    return found


def _names(palette: Palette) -> dict[str, int]:
    """Return the index of everything that a color may be called."""
    first = [name[0] for name in palette.names]
    letters = {name[0]: i for i, name in enumerate(palette.names) if first.count(name[0]) == 1}
    return letters | {"-": -1} | {name: i for i, name in enumerate(palette.names)} | {OFF: -1}


def _colors(given: Any, fibers: int, palette: Palette, problems: list[str]) -> list[int]:
    """Return an index per fiber, -1 for off; what is wrong joins ``problems``."""
    known = _names(palette)
    short = [name for name in known if len(name) == 1]
    allowed = (
        f"allowed: {', '.join(short[:-1])}{' or ' if short[:-1] else ''}-, or "
        f"{', '.join(palette.names)} or {OFF}"
    )
    if given is None:
        problems.append(f"missing key colors, {allowed}, for each of {fibers} fibers")
        return [-1] * fibers
    entries = list(given.replace(" ", "")) if isinstance(given, str) else given
    if not isinstance(entries, list):
        problems.append(f"colors = {in_json(given)}, {allowed}, for each of {fibers} fibers")
        return [-1] * fibers
    if len(entries) != fibers:
        problems.append(f"colors has {len(entries)} entries, allowed: {fibers}, one per fiber")
    found = []
    for index, entry in enumerate(entries):
        name = entry.lower() if isinstance(entry, str) else entry
        if not isinstance(name, str) or name not in known:
            meant = did_you_mean(entry, palette.names)
            problems.append(f"colors[{index}] = {in_json(entry)}, {allowed}{meant}")
            name = OFF
        found.append(known[name])
    return (found + [-1] * fibers)[:fibers]


def _angles(given: Any, fibers: int, problems: list[str]) -> list[float]:
    """Return degrees per fiber; what is wrong joins ``problems``."""
    if given is None:
        problems.append("missing key angles_deg, allowed: 0 to 180, one number or one per fiber")
        return [90.0] * fibers
    entries = given if isinstance(given, list) else [given] * fibers
    if len(entries) != fibers:
        problems.append(f"angles_deg has {len(entries)} entries, allowed: {fibers}, one per fiber")
    wrong = [
        (index, entry)
        for index, entry in enumerate(entries)
        if isinstance(entry, list) or not _all_numbers(entry) or not 0.0 <= entry <= 180.0
    ]
    if wrong and not isinstance(given, list):
        problems.append(f"angles_deg = {in_json(given)}, allowed: 0 to 180")
    elif wrong:
        problems += [f"angles_deg[{i}] = {in_json(entry)}, allowed: 0 to 180" for i, entry in wrong]
    return [90.0] * fibers if wrong or len(entries) != fibers else [float(x) for x in entries]


def _power(given: Any, colors: list[int], scene: Scene, problems: list[str]) -> np.ndarray:
    """Return ``(fiber, color)``; ``given`` has a fraction per fiber, or such rows."""
    count = len(scene.palette.names)
    lit = one_led(np.array(colors), count)
    full = np.asarray(lit * limits_of(scene).led_power)
    if given is None:
        return full
    words = "allowed: 0 to 1, one number per fiber"
    try:
        power = np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        power = np.zeros(0)
    if not _all_numbers(given) or power.shape not in {(len(colors),), (len(colors), count)}:
        problems.append(f"power has another form than {len(colors)} numbers, {words}")
        return full
    for index in np.flatnonzero(~((power >= 0) & (power <= 1)).reshape(len(colors), -1).all(1)):
        problems.append(f"power[{index}] = {in_json(power[index].tolist())}, {words}")
    return lit * power[:, None] if power.ndim == 1 else power


def _all_numbers(given: Any) -> bool:
    """Return whether what is in lists are numbers: numpy would read texts and truth as some."""
    if isinstance(given, list):
        return all(map(_all_numbers, given))
    return isinstance(given, int | float) and not isinstance(given, bool)


def _refusal(path: Path, problems: list[str], option: str = "") -> DesignError:
    said = f"{path} is not a valid layout: {'; '.join(problems)}"
    return DesignError(said, field="design", option=option)
