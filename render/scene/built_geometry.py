"""Where lamps, a skin that is not flat, and probes cannot be, one sentence each.

In the air an end stays out of the silicone. One that is cast in lies wholly in one solid: the clear
pad, its window or the diffuser. It stays below the skin, which bends with it, and beside what is
pressed in at the sites.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from render.arrays import Array
from render.scene.lamps import EDGES, FACES, OUTWARD, Box, ListedLamp, PlacedLamp, Row, axes_across
from render.scene.sections import Bending, Diffuser, Indenter, Pad, Sites
from render.scene.skin import Skin

EMBEDDING = 0.01
"""mm of its own solid that there is around the end of a lamp, at least."""
RIM_POINTS = 32
"""Points of an end's rim that are asked whether they are free."""
STEEPEST_FACET = math.radians(85.0)
"""Slope of the skin and of a facet on it, together, at most."""


def row_problems(rows: tuple[Row, ...], width: float, length: float) -> Iterator[str]:
    """Yield what is wrong with rows by themselves, one sentence each; the pad's size in mm."""
    for number, row in enumerate(rows):
        key = f"rows.{number}"
        if (row.count is None) == (row.at is None):
            yield f"{key}: needs either count or at, the places of its lamps along the edge"
            continue
        side = width if row.edge in ("tip", "base") else length
        if row.at is not None:
            if len(set(row.at)) < len(row.at):
                yield f"{key}.at names a place twice, allowed: distinct places"
            reach = max(abs(place) for place in row.at)
            if reach > side / 2:
                yield (
                    f"{key}.at = {reach:g} mm lies beside the edge, allowed: "
                    f"{-side / 2:g} to {side / 2:g} mm"
                )
        elif row.size * row.diameter > side:
            yield (
                f"{key}.count = {row.size} lamps need {row.size * row.diameter:g} mm, "
                f"allowed: at most the edge of {side:g} mm"
            )


def listed_problems(lamps: tuple[ListedLamp, ...]) -> Iterator[str]:
    """Yield what is wrong with listed lamps by themselves."""
    for number, lamp in enumerate(lamps):
        key = f"lamps.{number}"
        for name in ("position", "direction"):
            if len(getattr(lamp, name)) != 3:
                yield f"{key}.{name} has {len(getattr(lamp, name))} numbers, allowed: x, y and z"
        if not any(lamp.direction):
            yield f"{key}.direction = 0, 0, 0 points nowhere, allowed: any other vector"
        elif lamp.turns and not any(lamp.direction[:2]):
            yield f"{key}: shines along z and cannot turn about it, leave out turns"


def can_be_placed(rows: tuple[Row, ...], lamps: tuple[ListedLamp, ...]) -> bool:
    """Return whether it is said of all lamps where they are and where they shine."""
    said = all((row.count is None) != (row.at is None) for row in rows)
    return said and all(
        len(lamp.position) == len(lamp.direction) == 3 and any(lamp.direction) for lamp in lamps
    )


def deep_row_problems(rows: tuple[Row, ...], lamps: tuple[PlacedLamp, ...]) -> Iterator[str]:
    """Yield which rows are said to be cast in, by a gap below 0, and have lamps in the air."""
    in_air = {lamp.key for lamp in lamps if lamp.solid is None}
    for number, row in enumerate(rows):
        key = f"rows.{number}"
        if row.gap < 0.0 and key in in_air:
            yield (
                f"{key}.gap = {row.gap:g} mm is how deep its lamps are cast in, but at height = "
                f"{row.height:g} mm they are in the air there, allowed: a depth and a height "
                "within the silicone, or a gap of 0 or more"
            )


def placement_problems(lamps: tuple[PlacedLamp, ...], box: Box) -> Iterator[str]:
    """Yield which lamps in the air are where none can be: partly in the silicone, or behind it.

    Of a row, the first that is.
    """
    told = set()
    for lamp in lamps:
        if lamp.solid is not None or lamp.key in told:
            continue
        outside = float(box.distance(lamp.position)[lamp.face])
        at = ", ".join(f"{value:g}" for value in lamp.position)
        if lamp.position[2] > box.high[2]:
            told.add(lamp.key)
            yield (
                f"{lamp.key} at z = {lamp.position[2]:g} mm lies above the pad, allowed: at most "
                f"its thickness of {box.high[2]:g} mm"
            )
        elif lamp.position[2] == box.high[2] and (box.distance(lamp.position) < 0.0).all():
            told.add(lamp.key)
            yield (
                f"{lamp.key} at ({at}) mm lies on the coating, which is opaque, allowed: beside "
                "the pad, under it, or cast in wholly below the coating"
            )
        elif lamp.recess >= outside:
            told.add(lamp.key)
            inside = lamp.recess - outside
            yield (
                f"{lamp.key} at ({at}) mm "
                f"{f'cuts {inside:.3g} mm into' if inside > 0.0 else 'touches'} the silicone"
                f"{' when it turns, allowed: more than' if lamp.turns else ', allowed: at least'} "
                f"{lamp.recess:.3g} mm from its {FACES[lamp.face]} face"
            )


def aim_problems(lamps: tuple[PlacedLamp, ...]) -> Iterator[str]:
    """Yield which lamps in the air turn their back on the pad, the first of a row.

    One that shines along its face is none: half of its cone meets the pad. Lamps that turn are
    none either: a design aims them.
    """
    told = set()
    for lamp in lamps:
        if lamp.solid is not None or lamp.key in told or lamp.turns:
            continue
        if _outwards(lamp) > 1e-9:
            told.add(lamp.key)
            yield (
                f"{_place(lamp)} shines away from the pad's {FACES[lamp.face]} face, allowed: a "
                "direction or tilt towards the pad"
            )


def embedding_problems(lamps: tuple[PlacedLamp, ...], box: Box, *, refracts: bool) -> Iterator[str]:
    """Yield which lamps in the silicone are not wholly in one solid, or shine out of a diffuser.

    ``refracts`` is whether light bends between the pad and a window.
    """
    for lamp in lamps:
        if lamp.solid is None:
            continue
        room = box.room(lamp.position, lamp.half_size, refracts=refracts)
        if room < EMBEDDING * (1 - 1e-6):
            yield (
                f"{_place(lamp)} is inside the {lamp.solid}, but its end "
                f"{'' if not lamp.turns else 'when it turns '}is less than {EMBEDDING:g} mm from "
                f"the border of that, or crosses it, allowed: {EMBEDDING - room:.3g} mm farther "
                "from that border, or wholly in the air"
            )
        elif lamp.solid == "diffuser" and lamp.turns:
            yield (
                f"{_place(lamp)} is inside the diffuser and turns, allowed: turns = false, as it "
                "is cast in"
            )
        elif lamp.solid == "diffuser" and _outwards(lamp) > 1e-9:
            yield (
                f"{_place(lamp)} is inside the diffuser on the {FACES[lamp.face]} edge and shines "
                "away from the pad, allowed: a direction into the pad, or along its edge"
            )


def embedding_under_skin_problems(
    lamps: tuple[PlacedLamp, ...], pad: Pad, skin: Skin | None, sites: Sites, probe: Indenter
) -> Iterator[str]:
    """Yield which lamps in the silicone reach through the skin, or into a pyramid pressed in."""
    x, y = sites.places.T
    height = np.full(len(x), pad.thickness)
    normal = np.tile([0.0, 0.0, 1.0], (len(x), 1))
    if skin is not None:
        height = height + skin.rise(x, y)
        slope_x, slope_y = skin.slope(x, y)
        normal = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=-1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    place = np.stack([x, y, height], axis=-1)
    for lamp in lamps:
        if lamp.solid is None:
            continue
        points = _end_points(lamp)
        if skin is not None:
            free = pad.thickness + skin.rise(points[:, 0], points[:, 1]) - points[:, 2]
            if free.min() < EMBEDDING:
                yield (
                    f"{_place(lamp)} reaches {EMBEDDING - free.min():.3g} mm too high for the "
                    f"skin, allowed: at least {EMBEDDING:g} mm below it"
                )
                continue
        # The circular cone around the pyramid of a site.
        offset = points[:, None] - place
        depth = -(offset * normal).sum(axis=-1)
        aside = np.linalg.norm(offset + depth[..., None] * normal, axis=-1)
        free = depth - probe.depth * (1.0 - aside / probe.radius)
        hit = np.flatnonzero(((free < EMBEDDING) & (aside < probe.radius)).any(axis=0))
        for site in hit[:1]:
            yield (
                f"{_place(lamp)} is where the pyramid of site {site} is pressed in, "
                f"{probe.depth:.3g} mm deep and {probe.radius:g} mm wide about "
                f"({round(x[site], 3) + 0.0:g}, {round(y[site], 3) + 0.0:g}) mm, allowed: below "
                "or beside it; move the lamp or the sites"
            )


def _end_points(lamp: PlacedLamp) -> Array:
    """Return points ``(point, 3)`` of a lamp's end; of one that turns, of the ball it sweeps."""
    azimuth = 2 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
    circle = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1) * lamp.diameter / 2
    normals = np.eye(3) if lamp.turns else lamp.beam[None]
    rings = [lamp.position[None]]
    rings += [lamp.position + circle @ axes_across(normal) for normal in normals]
    return np.concatenate(rings)


def _outwards(lamp: PlacedLamp) -> float:
    return float(lamp.beam @ OUTWARD[lamp.face])


def _place(lamp: PlacedLamp) -> str:
    return f"{lamp.key} at ({', '.join(f'{value:g}' for value in lamp.position)}) mm"


def skin_problems(
    skin: Skin,
    pad: Pad,
    bending: Bending,
    diffuser: Diffuser | None,
    lamps: tuple[PlacedLamp, ...],
    sites: Sites,
    probe: Indenter,
) -> Iterator[str]:
    """Yield what is wrong with the skin of a sensor, one sentence each."""
    angles = [math.degrees(angle) for angle in bending.angles]
    if any(angles):
        yield (
            f"bending.angles = {', '.join(f'{angle:g}' for angle in angles)} deg: a skin of "
            f"skin.shape = {skin.shape} does not bend, allowed with one: 0"
        )
    if diffuser is not None:
        yield (
            f"diffuser: it lies on edges of even height, which skin.shape = {skin.shape} does not "
            "leave, allowed with one: no diffuser"
        )
    alone = list(skin.problems(pad.width, pad.length, pad.thickness))
    yield from alone
    if not alone:
        yield from _lamps_above(skin, pad, lamps)
        yield from _pyramids_outside(skin, pad, sites, probe)


def _lamps_above(skin: Skin, pad: Pad, lamps: tuple[PlacedLamp, ...]) -> Iterator[str]:
    """Yield which lamps shine over the edge that they are before, one sentence for each key."""
    told = set()
    half = np.array([pad.width, pad.length]) / 2
    for lamp in lamps:
        foot = np.clip(lamp.position[:2], -half, half)
        edge = pad.thickness + float(skin.rise(*foot))
        above = lamp.solid is None and FACES[lamp.face] in EDGES and lamp.position[2] >= edge
        if above and lamp.key not in told:
            told.add(lamp.key)
            yield (
                f"{lamp.key} at z = {lamp.position[2]:g} mm lies above the skin, which is "
                f"{edge:.3g} mm high at the {FACES[lamp.face]} edge there, allowed: below that"
            )


def _pyramids_outside(skin: Skin, pad: Pad, sites: Sites, probe: Indenter) -> Iterator[str]:
    """Yield the first site whose pyramid leaves the pad, or stands on too curved a skin."""
    x, y = sites.places.T
    height = pad.thickness + skin.rise(x, y)
    slope_x, slope_y = skin.slope(x, y)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    apex = np.stack([x, y, height], axis=-1) - probe.depth * normal
    inside = (np.abs(apex[:, :2]) < np.array([pad.width, pad.length]) / 2).all(axis=1)
    for site in np.flatnonzero(~inside | (apex[:, 2] <= 0.0))[:1]:
        at = ", ".join(f"{value:.3g}" for value in apex[site])
        yield (
            f"indenter: the pyramid {probe.depth:.3g} mm deep at site {site} reaches ({at}) mm, "
            f"out of the pad, allowed: between its edges and above 0; lower indenter.slope, or "
            "move the sites"
        )
    steep = np.arccos(normal[:, 2])
    for site in np.flatnonzero(steep + probe.slope > STEEPEST_FACET)[:1]:
        yield (
            f"indenter.slope = {math.degrees(probe.slope):g} deg at site {site}, where the skin "
            f"slopes by {math.degrees(steep[site]):.3g} deg, allowed: together at most "
            f"{math.degrees(STEEPEST_FACET):g} deg"
        )
    turn = 2 * np.pi * np.arange(16) / 16
    around = probe.clearance * np.stack([np.cos(turn), np.sin(turn)])[:, :, None]
    fall = height + around[0] * slope_x + around[1] * slope_y - pad.thickness
    fall = np.abs(fall - skin.rise(x + around[0], y + around[1])).max(axis=0)
    for site in np.flatnonzero(fall >= probe.depth)[:1]:
        yield (
            f"indenter.radius = {probe.radius:g} mm: around site {site} the skin curves "
            f"{fall[site]:.3g} mm away from the plane that touches it, allowed: less than the "
            f"pyramid's depth of {probe.depth:.3g} mm; make skin or pyramids of another size"
        )
