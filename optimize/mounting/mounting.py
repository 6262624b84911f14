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

from optimize.design import Design, limits_of
from optimize.mounting.feeds import Feeds
from render.geometry import FiberHolder, fiber_edges, flat_fiber_poses
from render.scene import COLORS, Edge, Scene

ANGLE_STEP = 5.0
"""deg: what a jig and a steady hand keep to."""
PRICED_STEPS = (1.0, 2.0, 5.0, 10.0, 15.0, 30.0)
STRAIGHT = 0.5
"""deg: leaning by less than this reads as straight in."""


@dataclass(frozen=True)
class MountedFiber:
    """One row of a wiring sheet; the names are the columns of the CSV.

    ``x_mm``, ``y_mm``, ``z_mm`` is the center of the fiber's end, ``towards_*`` the unit vector of
    its beam; the fiber leaves the pad the other way. ``angle_deg`` is phi: 90 points straight in, 0
    to the tip on the sides and to the right on the tip edge; ``found_deg`` is what the search
    chose. ``tilt_deg`` leads out of the plane, towards the coating if positive. ``channel`` counts
    the board's channels from 0, three to an LED.
    """

    fiber: int
    edge: Edge
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
    color: str
    power: float
    current_ma: float
    led: int
    channel: int | None


@dataclass(frozen=True, eq=False)
class Mounting:
    """A design as it is mounted, and what rounding its angles cost.

    Arguments:
        scene: the sensor.
        found: the design before rounding.
        design: the design as mounted.
        step: of its angles, deg; 0 where they are as found.
        fibers: the rows of the sheet.
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
        """What all LEDs together draw, mA."""
        return sum(fiber.current_ma for fiber in self.fibers)

    @property
    def colors_exchange(self) -> bool:
        """Whether red, green and blue may be exchanged with each other in all fibers at once.

        S knows no color by name, so they may where no limit does.
        """
        limits = limits_of(self.scene)
        return limits.colors_alike and len(set(limits.led_power.tolist())) == 1


def mount(
    scene: Scene,
    found: Design,
    score: Callable[[Design], float] | None = None,
    *,
    step: float | None = None,
    feeds: Feeds | None = None,
) -> Mounting:
    """Return how ``found`` is mounted.

    Arguments:
        scene: the sensor.
        found: what a search found.
        score: returns S of a design, in counts; without it nothing is priced.
        step: deg between angles, 0 to leave them; None: the scene's own step, else `ANGLE_STEP`.
        feeds: of the LEDs.
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
    writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def _rounded(scene: Scene, design: Design, step: float) -> Design:
    """Return the design on the nearest steps (deg) on which no fibers meet; fixed ones stay."""
    limits = replace(limits_of(scene), step=math.radians(step))
    return Design(limits.nearest_directions(design.phi), design.power)


def _rows(scene: Scene, found: Design, design: Design, feeds: Feeds) -> tuple[MountedFiber, ...]:
    poses = flat_fiber_poses(scene)
    beams = poses.directions(design.phi, scene.fibers.tilt)
    rows = []
    for i, (edge, color) in enumerate(zip(fiber_edges(scene), design.color_names, strict=True)):
        x, y, z = (round(float(v), 3) for v in poses.position[i])
        towards = [round(float(v), 4) + 0.0 for v in beams[i]]
        angle = round(float(np.degrees(design.phi[i])), 2)
        power, led = float(design.power[i].sum()), feeds.leds[i] if feeds.leds else i
        lit = color in COLORS
        rows.append(
            MountedFiber(
                fiber=i,
                edge=edge,
                x_mm=x,
                y_mm=y,
                z_mm=z,
                angle_deg=angle,
                found_deg=round(float(np.degrees(found.phi[i])), 2),
                tilt_deg=round(math.degrees(scene.fibers.tilt), 2),
                leans=leaning(edge, angle),
                towards_x=towards[0],
                towards_y=towards[1],
                towards_z=towards[2],
                diameter_mm=scene.fibers.diameter,
                gap_mm=scene.fibers.gap,
                color=color,
                power=round(power, 3),
                current_ma=round(power * feeds.milliamperes, 1),
                led=led,
                channel=3 * led + feeds.order.index(color[0]) if lit else None,
            )
        )
    return tuple(rows)


def leaning(edge: Edge, angle: float) -> str:
    """Say in words where a beam at ``angle`` deg leans.

    >>> leaning("left", 70.0), leaning("tip", 100.0), leaning("right", 90.0)
    ('20° to the tip', '10° to the left', 'straight in')
    """
    lean = 90.0 - angle
    if abs(lean) < STRAIGHT:
        return "straight in"
    low, high = ("right", "left") if edge == "tip" else ("tip", "base")
    return f"{abs(lean):g}° to the {low if lean > 0 else high}"
