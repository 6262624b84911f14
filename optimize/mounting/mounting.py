"""How the fibers of a design are mounted: place, direction, LED and current of each.

Angles are rounded to steps that can be mounted, and the price in counts is known for coarser steps
too. Positions are in the flat pad frame of `render.geometry.bending`: x across, y from base to tip,
z from the camera-side face to the coating, in mm; the origin is the center of the camera-side face.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optimize.design import DARK, Design, currents, limits_of, part_entries, prices
from optimize.robust import (
    MATERIALS,
    material_slopes,
    sensitivities,
    spread_words,
    tolerances_of,
)
from optimize.scoring import ScoreMerit, TableScorer, predict_design, search_table
from render.chebyshev import chebyshev_nodes
from render.geometry import FiberHolder, fiber_edges, flat_fiber_poses
from render.progress import OnProgress
from render.scene import OFF, Scene
from surrogate.runtime import Checker

FULL_LEVEL = 255
"""Of a channel, as boards are told."""


@dataclass(frozen=True)
class Feeds:
    """Which LED of the board feeds each fiber.

    A board has three channels to an LED, red, green and blue on most. Color c of the scene is
    channel c mod 3 of LED c div 3 among the LEDs of its fiber, which are as many as it takes: one
    for three colors. ``leds`` ``(fiber,)`` count them from 0, None: fiber i has number i;
    ``order`` of an LED's channels is like ``rgb``.
    """

    leds: tuple[int, ...] | None = None
    order: str = "rgb"

    def channel(self, fiber: int, color: int, colors: int) -> tuple[int, int]:
        """Return the LED that lights ``fiber`` in one of ``colors``, and its channel, 0 to 2.

        >>> Feeds(order="grb").channel(4, 0, 3), Feeds().channel(4, 5, 6)
        ((4, 1), (9, 2))
        """
        first = (fiber if self.leds is None else self.leds[fiber]) * leds_per_fiber(colors)
        return first + color // 3, self.order.index("rgb"[color % 3])


def leds_per_fiber(colors: int) -> int:
    """Return how many LEDs of three channels each it takes to light a fiber in ``colors``."""
    return -(-colors // 3)


ANGLE_STEP = 5.0
"""deg: what a jig and a steady hand keep to."""
PRICED_STEPS = (1.0, 2.0, 5.0, 10.0, 15.0, 30.0)
STRAIGHT = 0.5
"""deg: leaning by less than this reads as straight in."""


FIXED = "does not turn"


@dataclass(frozen=True)
class MountedFiber:
    """One row of a wiring sheet; the names are the columns of the CSV.

    ``x_mm``, ``y_mm``, ``z_mm`` is the center of the fiber's end, ``towards_*`` the unit vector of
    its beam; the fiber leaves the pad the other way. ``angle_deg`` is phi: 90 points straight in, 0
    to the tip on the sides and to the right on the tip edge; ``found_deg`` is what the search
    chose. ``tilt_deg`` leads out of the plane, towards the coating if positive. ``channel`` counts
    the board's channels from 0, three to an LED; see `optimize.mounting.Feeds`. ``level`` is what
    the board is told, 0 to 255, in proportion to the power. ``levels`` are those of each shot;
    ``color``, ``power`` and current are of the LED where it shines. The CSV has ``shot_1`` and so
    on in their place, where there are several. ``part`` is the LED that the color is of, where that
    is a known one.
    """

    fiber: int
    edge: str
    x_mm: float
    y_mm: float
    z_mm: float
    angle_deg: float
    found_deg: float
    tilt_deg: float
    leans: str
    towards_x: float
    towards_y: float
    towards_z: float
    diameter_mm: float
    gap_mm: float
    part: str
    color: str
    power: float
    current_ma: float
    level: int
    led: int
    channel: int | None
    levels: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Mounting:
    """A design as it is mounted, and what rounding its angles cost.

    Arguments:
        scene: the sensor.
        found: the design before rounding.
        design: the design as mounted.
        step: of its angles, deg; 0 where they are as found.
        fibers: the rows of the sheet, without `empty_places`.
        score_found, score: S of both, in counts; None where nobody rated them.
        prices: counts that every step (deg) of `PRICED_STEPS` from ``step`` on costs.
    """

    scene: Scene
    found: Design
    design: Design
    step: float
    fibers: tuple[MountedFiber, ...]
    score_found: float | None
    score: float | None
    prices: dict[float, float]

    @property
    def problems(self) -> list[str]:
        """Which fibers meet in the holder; nothing for what a search found."""
        return list(FiberHolder.of(self.scene).problems(self.design.phi))

    @property
    def current(self) -> float:
        """What all LEDs together draw, mA; in the shot that draws most."""
        drive = self.design.palette.in_shots(self.design.drive)
        return float((drive @ currents(self.scene)).sum(axis=1).max())

    @property
    def price(self) -> float | None:
        """What the parts of all lit lamps cost, US dollars; None where one is not known."""
        names = self.scene.palette.one_shot.names
        each = dict(zip(names, prices(self.scene).tolist(), strict=True))
        total = sum(each[fiber.color] for fiber in self.fibers if fiber.color != OFF)
        return None if math.isnan(total) else total

    @property
    def colors_exchange(self) -> bool:
        """Whether all colors may be exchanged with each other in all fibers at once.

        S knows no color by name, so they may where each has a channel of its own and no limit, and
        the skin looks alike in all of them.
        """
        if self.scene.by_channel:
            return False
        limits = limits_of(self.scene)
        alike = limits.colors_alike and limits.palette.exchangeable
        return alike and len(set(limits.led_power.tolist())) == 1


def mount(
    scene: Scene,
    found: Design,
    score: Callable[[Design], float] | None = None,
    *,
    step: float | None = None,
    feeds: Feeds | None = None,
) -> Mounting:
    """Return how ``found`` is mounted.

    ``score`` returns S of a design in counts; without it nothing is priced. ``step`` is deg between
    angles, 0 to leave them; None: the scene's own step, else `ANGLE_STEP`.
    """
    if step is None:
        own = scene.constraints.angle_step if scene.constraints else None
        step = ANGLE_STEP if own is None else math.degrees(own)
    design = found if step == 0.0 else _rounded(scene, found, step)
    prices, before, after = {}, None, None
    if score is not None:
        before, after = score(found), score(design)
        for size in PRICED_STEPS:
            if size >= step:
                prices[size] = before - score(_rounded(scene, found, size))
    rows = _rows(scene, found, design, feeds or Feeds())
    return Mounting(scene, found, design, step, rows, before, after, prices)


def wiring_csv(mounting: Mounting) -> str:
    """Return the wiring sheet as CSV, one row per fiber under the names of `MountedFiber`."""
    stream = io.StringIO()
    rows = [asdict(fiber) for fiber in mounting.fibers]
    for row in rows:
        levels = row.pop("levels")
        if len(levels) > 1:
            row |= {f"shot_{shot}": level for shot, level in enumerate(levels, start=1)}
    writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def _rounded(scene: Scene, design: Design, step: float) -> Design:
    """Return the design on the nearest steps (deg) on which no fibers meet; fixed ones stay."""
    limits = replace(limits_of(scene), step=math.radians(step))
    return replace(design, phi=limits.nearest_directions(design.phi))


def _rows(scene: Scene, found: Design, design: Design, feeds: Feeds) -> tuple[MountedFiber, ...]:
    poses, lamps = flat_fiber_poses(scene), scene.placed_lamps()
    beams, empty = poses.directions(design.phi), empty_places(scene, design)
    palette, leds = design.palette, design.palette.one_shot.names
    shots = palette.in_shots(design.drive).sum(axis=2)
    entries, full = part_entries(scene), currents(scene)
    rows = []
    for i, (edge, number) in enumerate(zip(fiber_edges(scene), design.colors, strict=True)):
        if empty[i]:
            continue
        x, y, z = (round(float(v), 3) for v in poses.position[i])
        towards = [round(float(v), 4) + 0.0 for v in beams[i]]
        angle = round(float(np.degrees(design.phi[i])), 2)
        power, color_index = float(shots[:, i].max()), int(palette.led[max(number, 0)])
        color = OFF if number == DARK else leds[color_index]
        entry = entries[color_index] if color != OFF else None
        led, place = feeds.channel(i, color_index, palette.led_count)
        rows.append(
            MountedFiber(
                fiber=i,
                edge=edge,
                x_mm=x,
                y_mm=y,
                z_mm=z,
                angle_deg=angle,
                found_deg=round(float(np.degrees(found.phi[i])), 2),
                tilt_deg=round(math.degrees(lamps[i].tilt), 2),
                leans=leaning(edge, angle) if lamps[i].turns else FIXED,
                towards_x=towards[0],
                towards_y=towards[1],
                towards_z=towards[2],
                diameter_mm=lamps[i].diameter,
                gap_mm=round(float(poses.gap[i]), 6),
                part="" if entry is None else entry.led.name,
                color=color,
                power=round(power, 3),
                current_ma=0.0 if color == OFF else round(power * full[color_index], 1),
                level=round(FULL_LEVEL * power),
                led=led,
                channel=None if color == OFF else 3 * led + place,
                levels=tuple(round(FULL_LEVEL * float(one)) for one in shots[:, i]),
            )
        )
    return tuple(rows)


def empty_places(scene: Scene, design: Design) -> NDArray[np.bool_]:
    """Return which lamps ``(F,)`` neither the baseline nor ``design`` lights: nothing is there."""
    baseline = np.array([color == OFF for color in scene.baseline_colors()])
    return np.asarray(baseline & (design.colors == DARK))


def leaning(edge: str, angle: float) -> str:
    """Say in words where a beam at ``angle`` deg leans.

    >>> leaning("left", 70.0), leaning("tip", 100.0), leaning("right", 90.0)
    ('20° to the tip', '10° to the left', 'straight in')
    """
    lean = 90.0 - angle
    if abs(lean) < STRAIGHT:
        return "straight in"
    if edge == "listed":
        return f"{abs(lean):g}° to the {'left' if lean > 0 else 'right'} of its direction"
    low, high = ("right", "left") if edge in ("tip", "base") else ("tip", "base")
    return f"{abs(lean):g}° to the {low if lean > 0 else high}"


LAYER_NODES = 13
"""Directions of a table with slopes by the material; enough for tenths of a count."""


@dataclass(frozen=True)
class ErrorCost:
    """What an error of a standard deviation named by ``what`` takes from S, in counts.

    ``mean`` is lost on average, ``low`` is exceeded by one sensor in ten.
    """

    what: str
    mean: float
    low: float


def surrogate_score(checker: Checker, scene: Scene) -> Callable[[Design], float]:
    """Return what rates designs on the surrogate, for `optimize.mounting.mount`."""
    bends = np.array(scene.state_axis)
    return lambda design: float(predict_design(checker, design, bends)["score"])


def mounting_error_costs(
    checker: Checker,
    scene: Scene,
    design: Design,
    *,
    layer: bool = False,
    progress: OnProgress | None = None,
) -> list[ErrorCost]:
    """Return what the tolerances of ``scene`` cost ``design``, the dearest first.

    ``layer`` asks also for those of the material, with two previews for each, of which ``progress``
    is told.
    """
    spreads = {
        name: spread
        for name, spread in tolerances_of(scene).items()
        if layer or name not in MATERIALS
    }
    nodes = chebyshev_nodes(LAYER_NODES, 0.0, np.pi)
    slopes = material_slopes(scene, spreads, nodes, progress)
    table = checker.transport_table(nodes) if slopes else search_table(checker)
    merit = ScoreMerit(TableScorer(table, limits=limits_of(scene)))
    found = sensitivities(merit, design, spreads, slopes)
    return [
        ErrorCost(spread_words(one.name, spreads[one.name]), one.mean_loss, one.low_loss)
        for one in found
    ]
