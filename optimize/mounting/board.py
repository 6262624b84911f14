"""The lamps of a design as a board maker draws them: DXF and SVG in mm, a layer for each kind.

Seen along z from outside, x to the right and y to the tip: the pad's outline, every body's outline,
its center, its beam, and its number and color as text. A body is the disk of its end: a circle
where it shines up, a line where it shines along the board. The DXF is of release 12, which every
program reads (AutoCAD Release 12 Customization Manual, chapter 11).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal
from xml.sax.saxutils import escape

import numpy as np

from optimize.mounting.mounting import MountedFiber, Mounting
from render.arrays import Array
from render.scene import Scene
from render.scene.lamps import axes_across

LAYERS = {"PAD": 7, "BODIES": 5, "CENTERS": 1, "BEAMS": 3, "NUMBERS": 7, "COLORS": 8}
"""Each kind of thing, and its color by AutoCAD's index."""
INKS = {7: "#1c1f24", 5: "#2f5fd0", 1: "#c81e1e", 3: "#2a8f3c", 8: "#8a8f98"}
SIDES = 32
"""Of the polygon that stands for a disk that is seen aslant."""
BEAM, LETTERS, MARGIN = 2.0, 0.8, 2.0
"""mm: length of a beam, height of letters, and paper around all."""
WIDTH = 0.8 * LETTERS
"""mm that a letter takes, at most: fonts differ."""
FLAT = 1e-3
"""Part of its diameter below which a disk is seen as a line, or as a circle."""


@dataclass(frozen=True, eq=False)
class Shape:
    """One thing of a drawing; lengths in mm.

    Arguments:
        layer: one of `LAYERS`.
        kind: what it is; a ``loop`` is closed.
        points: ``(n, 2)``; the center of a circle, the left end of a text.
        radius: of a circle.
        text: what is written.
    """

    layer: str
    kind: Literal["point", "line", "loop", "circle", "text"]
    points: Array
    radius: float = 0.0
    text: str = ""


def board_shapes(mounting: Mounting) -> tuple[Shape, ...]:
    """Return all that is drawn of a design: only lamps that are lit.

    Numbers are those of the wiring sheet.
    """
    lit = (fiber for fiber in mounting.fibers if fiber.power > 0.0)
    return (*_pad(mounting.scene), *(shape for fiber in lit for shape in _lamp(fiber)))


def board_dxf(mounting: Mounting) -> str:
    """Return the drawing as DXF of release 12, in mm."""
    shapes = board_shapes(mounting)
    low, high = _bounds(shapes)
    pairs: list[tuple[int, object]] = [
        (999, f"tactilux, {mounting.scene.name}, seen from outside, mm"),
        (0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009"), (9, "$INSUNITS"), (70, 4),
        (9, "$EXTMIN"), (10, low[0]), (20, low[1]), (9, "$EXTMAX"), (10, high[0]), (20, high[1]),
        (0, "ENDSEC"), (0, "SECTION"), (2, "TABLES"), (0, "TABLE"), (2, "LAYER"),
        (70, len(LAYERS)),
    ]  # fmt: skip
    for name, color in LAYERS.items():
        pairs += [(0, "LAYER"), (2, name), (70, 0), (62, color), (6, "CONTINUOUS")]
    pairs += [(0, "ENDTAB"), (0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES")]
    for shape in shapes:
        pairs += _entity(shape)
    pairs += [(0, "ENDSEC"), (0, "EOF")]
    return "".join(
        f"{code:>3}\n{f'{value:.4f}' if isinstance(value, float) else value}\n"
        for code, value in pairs
    )


def board_svg(mounting: Mounting) -> str:
    """Return the drawing as an SVG file that prints at its true size, a group for each layer."""
    shapes = board_shapes(mounting)
    low, high = _bounds(shapes)
    width, height = high - low
    groups = []
    for layer, color in LAYERS.items():
        drawn = "".join(_svg(shape, low[0], high[1]) for shape in shapes if shape.layer == layer)
        ink = INKS[color]
        written = f'fill="{ink}" stroke="none"' if layer in ("NUMBERS", "COLORS") else (
            f'fill="none" stroke="{ink}" stroke-width="0.1"'
        )  # fmt: skip
        groups.append(f'<g id="{layer}" {written}>{drawn}</g>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.3f}mm" height="{height:.3f}mm" '
        f'viewBox="0 0 {width:.3f} {height:.3f}" font-family="sans-serif" '
        f'font-size="{LETTERS / 0.7:.3f}"><title>{escape(mounting.scene.name)}, seen from '
        f'outside, mm</title><rect width="100%" height="100%" fill="white"/>'
        f"{''.join(groups)}</svg>\n"
    )


def _pad(scene: Scene) -> Iterator[Shape]:
    """Yield the outline of the clear pad, and that of its diffuser."""
    half = np.array([scene.pad.width, scene.pad.length]) / 2
    turns = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    yield Shape("PAD", "loop", turns * half)
    if scene.diffuser is not None:
        low, high = scene.box.low[:2], scene.box.high[:2]
        yield Shape("PAD", "loop", np.where(turns < 0, low, high))


def _lamp(fiber: MountedFiber) -> Iterator[Shape]:
    """Yield outline, center, beam and texts of one lamp."""
    place, radius = np.array([fiber.x_mm, fiber.y_mm]), fiber.diameter_mm / 2
    beam = np.array([fiber.towards_x, fiber.towards_y, fiber.towards_z])
    level = float(np.hypot(*beam[:2]))
    if level < FLAT:
        yield Shape("BODIES", "circle", place[None], radius)
    elif abs(beam[2]) < FLAT:
        across = radius / level * np.array([-beam[1], beam[0]])
        yield Shape("BODIES", "line", np.stack([place - across, place + across]))
    else:
        turn = 2 * np.pi * np.arange(SIDES) / SIDES
        circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        yield Shape("BODIES", "loop", place + radius * (circle @ axes_across(beam))[:, :2])
    yield Shape("CENTERS", "point", place[None])
    if level >= FLAT:
        yield Shape("BEAMS", "line", np.stack([place, place + BEAM * beam[:2]]))
    away = np.array([0.0, 1.0]) if level < FLAT else -beam[:2] / level
    number = str(fiber.fiber)
    width, part = WIDTH * (len(number) + 1 + len(fiber.color)), WIDTH * (len(number) + 1)
    middle = place + away * (radius + LETTERS + width / 2 * abs(away[0]))
    corner = middle - [width / 2, LETTERS / 2]
    yield Shape("NUMBERS", "text", corner[None], text=number)
    yield Shape("COLORS", "text", corner[None] + [part, 0.0], text=fiber.color)


def _bounds(shapes: tuple[Shape, ...]) -> tuple[Array, Array]:
    """Return the corners of the paper, ``(2,)`` each."""
    low = np.min([shape.points.min(axis=0) - shape.radius for shape in shapes], axis=0)
    ends = [
        shape.points.max(axis=0) + shape.radius + [WIDTH * len(shape.text), 0.0] for shape in shapes
    ]
    return low - MARGIN, np.max(ends, axis=0) + MARGIN


def _entity(shape: Shape) -> Iterator[tuple[int, object]]:
    """Yield the group codes and values of one entity."""
    first, last = shape.points[0], shape.points[-1]
    name = {"point": "POINT", "line": "LINE", "loop": "POLYLINE", "circle": "CIRCLE",
            "text": "TEXT"}[shape.kind]  # fmt: skip
    yield from ((0, name), (8, shape.layer))
    if shape.kind == "loop":
        yield from ((66, 1), (10, 0.0), (20, 0.0), (30, 0.0), (70, 1))
        for x, y in shape.points.tolist():
            yield from ((0, "VERTEX"), (8, shape.layer), (10, x), (20, y), (30, 0.0))
        yield from ((0, "SEQEND"), (8, shape.layer))
        return
    yield from ((10, float(first[0])), (20, float(first[1])), (30, 0.0))
    if shape.kind == "line":
        yield from ((11, float(last[0])), (21, float(last[1])), (31, 0.0))
    elif shape.kind == "circle":
        yield (40, shape.radius)
    elif shape.kind == "text":
        yield from ((40, LETTERS), (1, shape.text))


def _svg(shape: Shape, left: float, top: float) -> str:
    """Return one shape as SVG, y downwards from ``top``."""
    points = np.stack([shape.points[:, 0] - left, top - shape.points[:, 1]], axis=-1)
    (x, y), last = points[0].tolist(), points[-1].tolist()
    if shape.kind == "circle":
        return f'<circle cx="{x:.4f}" cy="{y:.4f}" r="{shape.radius:.4f}"/>'
    if shape.kind == "text":
        return f'<text x="{x:.4f}" y="{y:.4f}">{escape(shape.text)}</text>'
    if shape.kind == "line":
        return f'<path d="M{x:.4f} {y:.4f}L{last[0]:.4f} {last[1]:.4f}"/>'
    if shape.kind == "loop":
        corners = "L".join(f"{a:.4f} {b:.4f}" for a, b in points.tolist())
        return f'<path d="M{corners}Z"/>'
    return f'<path d="M{x - 0.2:.4f} {y:.4f}h0.4M{x:.4f} {y - 0.2:.4f}v0.4"/>'
