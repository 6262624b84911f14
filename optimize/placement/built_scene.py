"""The sensor that a design is: the lamps that are lit, as the baseline of a scene of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import tomlkit

from optimize.design import DARK, Array, Colors, Design
from render.errors import DesignError
from render.geometry import flat_fiber_poses
from render.scene import EDGES, RGB, Scene
from render.scene.scene_file import scene_from_text, written_of
from render.scene.schema.toml_document import (
    body_of,
    in_line,
    listed_document,
    set_lamps,
    table_of,
    text_of,
)

STRAIGHT = 1e-9
"""rad: what points straight in up to rounding stays as its row has it."""
HEAD = "Lamps and baseline are those of a design for {}; other comments are of its file."
DIGITS = 9
"""Of mm and of directions; what a file rounds away changes no color by more than 1e-8."""


def built_scene(scene: Scene, design: Design, name: str) -> Scene:
    """Return the scene of a sensor whose lamps are those that ``design`` lights.

    A row stays a row where all of its lamps are lit and point straight in; other lamps are listed
    one by one. The baseline has the design's colors, and its directions are where lamps point.

    Raises:
        SceneError: the scene has no file, or ``name`` is none.
        DesignError: the design is not the scene's, or lights nothing.
    """
    design.check_fits(scene)
    colors = design.colors
    if (colors == DARK).all():
        raise DesignError(
            f"the design lights none of {scene.name}'s lamps, allowed: at least one that shines",
            field="power",
        )
    document = listed_document(scene)
    placed, straight = scene.placed_lamps(), np.abs(design.phi - math.pi / 2) <= STRAIGHT
    whole: dict[str, bool] = {}
    for lamp, color, as_it_is in zip(placed, colors, straight, strict=True):
        key = "fibers" if lamp.key.startswith("fibers") else lamp.key
        kept = bool(color != DARK and (as_it_is or not lamp.turns))
        whole[key] = whole.get(key, True) and kept
    beams = flat_fiber_poses(scene).directions(design.phi)
    listed: list[Any] = []
    numbers: list[int] = []
    in_rows: list[int] = []
    for number, lamp in enumerate(placed):
        key = "fibers" if lamp.key.startswith("fibers") else lamp.key
        if whole[key] and lamp.edge is not None:
            in_rows.append(number)
        elif colors[number] != DARK:
            numbers.append(number)
            kept = whole[key]
            listed.append(
                document["lamps"][int(key.split(".")[1])]
                if kept
                else _lamp(document, lamp.key, number, lamp.position, beams[number])
            )
    _keep_rows(document, whole)
    set_lamps(document, listed)
    _set_baseline(document, scene, colors, in_rows, numbers)
    turned = any(placed[i].turns and not straight[i] for i in numbers)
    _keep_limits(document, [*in_rows, *numbers], turned)
    _keep_powers(document, design)
    document["name"] = name
    return scene_from_text(
        text_of(document, HEAD.format(scene.name)), f"the scene {name}", written_of(scene).folder
    )


def unsaid_powers(design: Design) -> list[str]:
    """Return what of a design's powers its scene cannot say, a sentence or none."""
    if _power_of_colors(design) is not None:
        return []
    return [
        "Lamps of one color have powers of their own, which a scene file cannot say: its baseline "
        "has all of them at full power"
    ]


def _lamp(
    document: tomlkit.TOMLDocument, key: str, number: int, position: Array, beam: Array
) -> dict[str, Any]:
    """Return one lamp as a list has it; its numbers are those of the design."""
    source = f"lamp {number} of the design ({key})"
    return {
        "position": {"value": _rounded(position), "unit": "mm", "source": source},
        "direction": {"value": _rounded(beam), "source": source},
        **body_of(document, key),
    }


def _rounded(vector: Array) -> list[float]:
    return [float(value) for value in np.round(vector, DIGITS) + 0.0]


def _keep_rows(document: tomlkit.TOMLDocument, whole: Mapping[str, bool]) -> None:
    """Leave the rows out whose lamps are listed now."""
    if not whole.get("fibers", True):
        document.pop("fibers")
    rows = document.get("rows", ())
    for number in reversed(range(len(rows))):
        if not whole[f"rows.{number}"]:
            del rows[number]
    if "rows" in document and not len(rows):
        document.pop("rows")


def _set_baseline(
    document: tomlkit.TOMLDocument,
    scene: Scene,
    colors: Colors,
    in_rows: list[int],
    listed: list[int],
) -> None:
    """Write the design's colors: of edges one by one, or one alone where all are alike."""
    baseline, palette, placed = table_of(document, "baseline"), scene.palette, scene.placed_lamps()
    for edge in EDGES:
        named = [palette.name(colors[i]) for i in in_rows if placed[i].edge == edge]
        if named:
            baseline[edge] = named[0] if len(set(named)) == 1 else in_line(named)
        elif "fibers" not in document:
            baseline.pop(edge, None)
    baseline.pop("lamps", None)
    if listed:
        baseline["lamps"] = in_line([palette.name(colors[i]) for i in listed])


def _keep_limits(document: tomlkit.TOMLDocument, numbers: list[int], turned: bool) -> None:
    """Keep what still makes sense of constraints and search: lamps have other numbers now."""
    constraints = document.get("constraints", {})
    constraints.pop("off", None)
    fixed = []
    for entry in constraints.pop("fixed", ()):
        plain = dict(entry.unwrap() if hasattr(entry, "unwrap") else entry)
        if turned:
            plain.pop("angle", None)
        if plain["fiber"] in numbers and len(plain) > 1:
            fixed.append(plain | {"fiber": numbers.index(plain["fiber"])})
    if fixed:
        constraints["fixed"] = in_line(fixed)
    gaps = [] if turned else [dict(gap) for gap in constraints.get("forbidden", ())]
    constraints.pop("forbidden", None)
    for gap in gaps:
        if "fibers" in gap:
            gap["fibers"] = [numbers.index(fiber) for fiber in gap["fibers"] if fiber in numbers]
    gaps = [gap for gap in gaps if gap.get("fibers") != []]
    if gaps:
        constraints["forbidden"] = in_line(gaps)
    search = document.get("search", {})
    for key in ("lamps", "places"):
        search.pop(key, None)
    for name in ("constraints", "search"):
        if name in document and not len(document[name]):
            document.pop(name)


def _keep_powers(document: tomlkit.TOMLDocument, design: Design) -> None:
    """Write the power of each color where it is less than full."""
    for name, power in (_power_of_colors(design) or {}).items():
        if power < 1.0:
            constraints = table_of(document, "constraints")
            limits = constraints.get("colors", {}).get(name)
            if name in RGB.names and limits is None:
                constraints[f"power_{name}"] = {"value": power, "source": "the design's"}
            elif limits is not None:
                limits["power"] = in_line({"value": power, "source": "the design's"})
            else:
                colors = constraints.setdefault("colors", tomlkit.table())
                colors[name] = in_line({"power": {"value": power, "source": "the design's"}})


def _power_of_colors(design: Design) -> dict[str, float] | None:
    """Return the power of every color that is lit, None where lamps of one color differ."""
    found: dict[str, float] = {}
    names, led = design.palette.one_shot.names, design.palette.led
    for row, color in zip(design.drive, design.colors, strict=True):
        if color == DARK:
            continue
        name, power = names[led[color]], round(float(row[color]), DIGITS)
        if np.count_nonzero(row) > 1 or found.setdefault(name, power) != power:
            return None
    return found
