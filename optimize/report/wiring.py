"""The wiring sheet: what a builder needs on the bench, as a page, a picture, CSV and a jig."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

from optimize.design import Rating, ReadErrors, limits_of, save_design
from optimize.mounting import (
    FULL_LEVEL,
    ErrorCost,
    JigError,
    Mounting,
    banding_sentences,
    board_dxf,
    board_svg,
    drilling_jig,
    empty_places,
    stl_bytes,
    wiring_csv,
)
from optimize.readers import CameraModel
from optimize.report.illustrations import beam_length, drawing, png_bytes
from optimize.report.page import data_uri
from optimize.ui.console import counted
from render.describe import limit_sentences
from render.files import write_bytes, write_text
from render.geometry import LOWER, FiberHolder, fiber_edges, flat_fiber_poses, flat_sites
from render.scene import Scene, known_leds

CSV, JIG, MOUNTED = "wiring.csv", "jig.stl", "mounted.json"
BOARD, BOARD_PICTURE = "board.dxf", "board.svg"
AXES = 5.0
"""mm, length of the drawn axes."""


def write_wiring(folder: Path, mounting: Mounting, rating: Rating | None = None) -> str:
    """Write CSV, board, jig and the design as mounted into ``folder``; return why no jig."""
    write_text(folder / CSV, wiring_csv(mounting))
    write_text(folder / BOARD, board_dxf(mounting))
    write_text(folder / BOARD_PICTURE, board_svg(mounting))
    save_design(folder / MOUNTED, mounting.design, mounting.scene, rating)
    try:
        write_bytes(folder / JIG, stl_bytes(drilling_jig(mounting.scene, mounting.design)))
    except JigError as error:
        return str(error)
    return ""


def wiring_files(design: Path, no_jig: str = "") -> str:
    """Say what `write_wiring` wrote, and how the files of another step or board are made."""
    jig = f"no jig ({no_jig})" if no_jig else f"{JIG} (a drilling jig for the angles above, in mm)"
    return (
        f"Beside this page: {CSV}, {BOARD} and {BOARD_PICTURE} (centers, outlines and numbers of "
        f"lamps, in mm), {MOUNTED} (the design with the angles above) and {jig}. "
        f"For another step, other LEDs or another board: tactilux wiring {design} --help."
    )


def wiring_context(
    mounting: Mounting,
    title: str,
    errors: Sequence[ErrorCost] = (),
    files: str = "",
    read: ReadErrors | None = None,
) -> dict[str, Any]:
    """Return what the sheet's part of a page shows.

    ``errors`` are what errors of mounting cost, ``files`` a sentence about what lies beside the
    page, ``read`` the exposure that suits the design.
    """
    scene = mounting.scene
    facts = [
        *_ends(scene),
        *_empty(mounting),
        f"All LEDs together draw {mounting.current:.0f} mA.",
        *part_sentences(mounting),
        *(
            [f"A number beside a color is the level that the board is told, of {FULL_LEVEL}."]
            if any(0.0 < row.power < 1.0 for row in mounting.fibers)
            else []
        ),
        *_sequence(scene),
        *([] if read is None else exposure_sentences(read, scene)),
        *banding_sentences(mounting, 1.0 if read is None else read.exposure_factor / read.gain),
    ]
    return {
        "shots": [f"Shot {shot}" for shot in shot_numbers(scene)],
        "title": title,
        "word": "fiber" if scene.fibers else "lamp",
        "numbering": _numbering(scene),
        "turns": any(scene.turning),
        "across": "tip and base edge" if "base" in fiber_edges(scene) else "tip edge",
        "holder": bool(len(FiberHolder.of(scene).least)),
        "scheme": data_uri(png_bytes(wiring_drawing(mounting))),
        "facts": facts,
        "notes": [*_price(mounting), *_error_sentences(errors), *_freedom(mounting)],
        "problems": mounting.problems,
        "limits": list(limit_sentences(scene)),
        "files": files,
        "fibers": [
            {
                "number": str(row.fiber),
                "edge": row.edge,
                "x": f"{row.x_mm:.2f}",
                "y": f"{row.y_mm:.2f}",
                "color": row.color if row.power in (0.0, 1.0) else f"{row.color}, {row.level}",
                "ink": scene.palette.ink(row.color),
                "current": f"{row.current_ma:g}",
                "led": str(row.led),
                "channel": "" if row.channel is None else str(row.channel),
                "angle": f"{row.angle_deg:.1f}°",
                "leans": row.leans,
                "shots": [str(row.levels[shot - 1]) for shot in shot_numbers(scene)],
            }
            for row in mounting.fibers
        ],
    }


def shot_numbers(scene: Scene) -> range:
    """Return the numbers of a scene's shots, from 1; none where there is one picture."""
    shots = scene.palette.shots
    return range(1, shots + 1) if shots > 1 else range(0)


def _sequence(scene: Scene) -> list[str]:
    """Say how pictures are taken where there are several."""
    shots = scene.palette.shots
    if shots == 1:
        return []
    return [
        f"Take {shots} pictures one after the other; a column of each shot has the level that "
        f"every LED is told, of {FULL_LEVEL}."
    ]


def part_sentences(mounting: Mounting) -> list[str]:
    """Say which parts the lamps are, with their data sheets, and what they cost together."""
    known = known_leds(mounting.scene.parts or ())
    names = [row.part for row in mounting.fibers if row.part and row.power > 0.0]
    said = []
    for name in dict.fromkeys(names):
        led = known[name]
        bears = [die.max_ma for die in led.dies if die.max_ma is not None]
        limit = f", at most {min(bears):g} mA" if bears else ""
        said.append(f"{names.count(name)} {name}: {led.source}{limit}.")
    if names and mounting.price is not None:
        said.append(f"These parts cost about {mounting.price:.2f} US dollars.")
    return said


def exposure_sentences(read: ReadErrors, scene: Scene) -> list[str]:
    """Say how a design is exposed, and how steep a contact may be before colors saturate.

    >>> from render.scene import load_scene
    >>> read = ReadErrors(1.4, 1.2, 1.25, 1.0, (24.0, None, 29.3))
    >>> for sentence in exposure_sentences(read, load_scene("digit")):
    ...     print(sentence)
    Expose 1.25 times as long as the scene's exposure, at gain 1; 255 counts are 10000 electrons.
    At most 0.1% of all colors saturate: red from 24° of tilt on, green never, blue from 29°.
    """
    camera, time = CameraModel.of(scene), read.exposure_factor / read.gain
    said = [
        f"{channel} never" if tilt is None else f"{channel} from {tilt:.0f}°"
        for channel, tilt in zip(scene.palette.channels, read.saturates_deg, strict=False)
    ]
    first = next((i for i, tilt in enumerate(read.saturates_deg) if tilt is not None), None)
    if first is not None:
        said[first] += " of tilt on"
    what = f"each of {camera.shots} shots " if camera.shots > 1 else ""
    return [
        f"Expose {what}{time:.3g} times as long as the scene's exposure, at gain {read.gain:.3g}; "
        f"255 counts are {camera.full_well / read.gain:.0f} electrons.",
        f"At most {camera.saturated:.1%} of all colors saturate{': ' * bool(said)}"
        f"{', '.join(said)}.",
    ]


WAYS = {
    "left": "along the left edge from base to tip",
    "tip": "along the tip from left to right",
    "right": "down the right edge",
    "base": "along the base from right to left",
}


def _numbering(scene: Scene) -> str:
    """Say in which order the lamps of a scene are numbered."""
    ways = [way for edge, way in WAYS.items() if edge in fiber_edges(scene)]
    if scene.lamps:
        ways.append("then one by one as they are listed" if ways else "as they are listed")
    *first, last = ways
    order = f"{', '.join(first)}{',' if len(first) > 1 else ''} and {last}" if first else last
    return (
        f"Looking at the skin from outside with the tip up, {'fibers' if scene.fibers else 'lamps'}"
        f" are numbered {order}."
    )


def _ends(scene: Scene) -> list[str]:
    """Say how the ends of the lamps lie, one sentence for each row."""
    sentences = []
    for row in scene.lamp_rows:
        tilt = np.degrees(row.tilt)
        side = "towards the coating" if tilt >= 0 else "towards the camera"
        behind = "diffuser" if row.edge in scene.diffuser_edges else "pad"
        place = (
            f"{row.gap:g} mm from the {behind}" if row.gap >= 0.0
            else f"cast in, {-row.gap:g} mm behind the face of the {behind}"
        )  # fmt: skip
        who = "Every fiber" if scene.fibers else f"Every lamp of the {row.edge} edge's row"
        sentences.append(
            f"{who}: {row.diameter:g} mm in diameter, the center of its end at z = "
            f"{row.height:g} mm and {place}; its beam is tilted "
            f"{abs(tilt):g}° {side}."
        )
    if scene.lamps:
        sentences.append("Listed lamps lie where the CSV says, and shine along its towards_*.")
    return list(dict.fromkeys(sentences))


def _empty(mounting: Mounting) -> list[str]:
    """Say that places are left out on which no lamp is."""
    count = len(mounting.design.phi) - len(mounting.fibers)
    if not count:
        return []
    return [
        f"{counted(count, 'place')} of the search {'has' if count == 1 else 'have'} no lamp and "
        f"{'is' if count == 1 else 'are'} not listed."
    ]


def _price(mounting: Mounting) -> list[str]:
    if not any(mounting.scene.turning):
        return []
    if mounting.score is None or mounting.score_found is None:
        return [f"Angles are rounded to {mounting.step:g}°."] if mounting.step else []
    texts = []
    if mounting.step:
        texts.append(
            f"Angles are rounded to {mounting.step:g}°: the design scores "
            f"{mounting.score:.1f} so, and {mounting.score_found:.1f} with angles as found; "
            f"rounding takes {mounting.score_found - mounting.score:.2f} counts."
        )
    others = [
        f"{step:g}° {price:.2f}" for step, price in mounting.prices.items() if step != mounting.step
    ]
    if others:
        texts.append(f"What other steps would take, in counts: {', '.join(others)}.")
    return texts


def _error_sentences(errors: Sequence[ErrorCost]) -> list[str]:
    if not errors:
        return []
    listed = "; ".join(f"{error.low:.1f} counts for {error.what}" for error in errors)
    return [
        "What errors in building cost: one sensor in ten loses more than the following, for a "
        f"standard deviation as named: {listed}."
    ]


def _freedom(mounting: Mounting) -> list[str]:
    if not mounting.colors_exchange:
        return []
    *first, last = mounting.scene.palette.names
    if not first:
        return []
    names = f"{', '.join(first)} and {last}".capitalize()
    return [
        f"{names} may be exchanged with each other in all fibers at once: the score knows no color "
        "by name."
    ]


def wiring_drawing(mounting: Mounting) -> Figure:
    """Draw the holder from outside, tip up: axes, fibers as they lie in it, numbers and beams.

    Lamps under the pad, which shine up out of the page, are drawn as the disks that they are.
    """
    scene, design = mounting.scene, mounting.design
    poses, holder = flat_fiber_poses(scene), FiberHolder.of(scene)
    beams = poses.directions(design.phi)[:, :2]
    position = poses.position[:, :2]
    sine = np.maximum((beams * poses.inward[:, :2]).sum(axis=1), 0.2)[:, None]
    under = poses.face == LOWER
    back = np.where(under[:, None], position, position - beams * holder.thickness / sine)
    aside = np.where(under[:, None], [0.0, 1.5], 1.5 * poses.inward[:, :2])
    label = back - aside
    half = np.array([scene.pad.width, scene.pad.length]) / 2
    gap = max((row.gap for row in scene.lamp_rows if row.gap > 0.0), default=0.0)
    near, far = scene.box.low[:2] - gap, scene.box.high[:2] + gap
    left, right = near - holder.thickness, far + holder.thickness
    low = np.minimum(label.min(axis=0), left) - 1.2
    high = np.maximum(label.max(axis=0), right) + 1.2
    low[1] = min(float(label[:, 1].min()), -half[1]) - 1.2
    beam = beam_length(scene)
    with drawing(4.2, 4.2 * (high[1] - low[1]) / (high[0] - low[0])) as figure:
        axes = figure.subplots()
        wall = [
            (left[0], low[1]), (left[0], right[1]), (right[0], right[1]), (right[0], low[1]),
            (far[0], low[1]), (far[0], far[1]), (near[0], far[1]), (near[0], low[1]),
        ]  # fmt: skip
        if len(holder.least):
            axes.add_patch(Polygon(wall, facecolor="#eef0f3", edgecolor="#b6bbc4", lw=0.6))
        if scene.diffuser is not None:
            corner, size = scene.box.low, scene.box.high - scene.box.low
            axes.add_patch(Rectangle(tuple(corner[:2]), *size[:2], color="#dfe2e7", lw=0))
        axes.add_patch(
            Rectangle(tuple(-half), *(2 * half), facecolor="#f6f7f9", edgecolor="#b6bbc4", lw=0.6)
        )
        sites = flat_sites(scene)
        axes.plot(sites[:, 0], sites[:, 1], "o", ms=2.0, color="#b6bbc4")
        _draw_axes(axes)
        arrow = {"arrowstyle": "-|>", "lw": 1.2, "mutation_scale": 8, "shrinkA": 0, "shrinkB": 0}
        empty, exclusive = empty_places(scene, design), limits_of(scene).exclusive
        # Where a body is, no other place is left.
        taken = np.zeros(len(empty), dtype=bool)
        if exclusive is not None:
            taken |= exclusive[:, ~empty].any(axis=1)
        for i, color in enumerate(design.color_names):
            if empty[i]:
                if taken[i]:
                    continue
                axes.plot(*position[i], "o", ms=2.0, mfc="none", mec="#b6bbc4", mew=0.6)
                continue
            ink = scene.palette.ink(color)
            if under[i]:
                axes.add_patch(Circle(tuple(position[i]), poses.radius[i], color=ink, alpha=0.85))
            else:
                axes.plot(*zip(back[i], position[i], strict=True), color=ink, lw=3.0, alpha=0.85,
                          solid_capstyle="butt")  # fmt: skip
            axes.annotate(
                "",
                xy=tuple(position[i] + beam * beams[i]),
                xytext=tuple(position[i]),
                arrowprops={**arrow, "color": ink},
            )
            axes.text(label[i, 0], label[i, 1], str(i), ha="center", va="center", fontsize=9.0)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.set_aspect("equal")
        axes.axis("off")
    return figure


def _draw_axes(axes: Any) -> None:
    """Draw the origin with x, y and, out of the page, z."""
    ink = "#1c1f24"
    for way, name in (((AXES, 0.0), "x"), ((0.0, AXES), "y")):
        axes.annotate(
            "",
            xy=way,
            xytext=(0.0, 0.0),
            arrowprops={"arrowstyle": "-|>", "color": ink, "lw": 0.9, "mutation_scale": 7,
                        "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        axes.text(1.16 * way[0], 1.16 * way[1], name, ha="center", va="center", fontsize=9.0)
    axes.plot(0.0, 0.0, "o", ms=7.0, mfc="white", mec=ink, mew=0.9)
    axes.plot(0.0, 0.0, "o", ms=2.2, color=ink)
    axes.text(-1.0, -1.3, "z", ha="center", va="center", fontsize=9.0)
