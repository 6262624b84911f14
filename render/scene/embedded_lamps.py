"""Lamps cast into the silicone: what stands in the way of their ends.

An end lies wholly in one solid: the clear pad, its window or the diffuser. It stays below the skin
at every state, which bends with it, and beside what is pressed in at the sites.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from render.arrays import Array
from render.scene.lamps import FACES, OUTWARD, Box, PlacedLamp
from render.scene.parts import Indenter, Pad, Sites
from render.scene.skin import Skin

EMBEDDING = 0.01
"""mm of its own solid that there is around the end of a lamp, at least."""
RIM_POINTS = 32
"""Points of an end's rim that are asked whether they are free."""


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
                f"({x[site]:g}, {y[site]:g}) mm, allowed: below or beside it; move the lamp or "
                "the sites"
            )


def _end_points(lamp: PlacedLamp) -> Array:
    """Return points ``(point, 3)`` of a lamp's end; of one that turns, of the ball it sweeps."""
    azimuth = 2 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
    circle = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1) * lamp.diameter / 2
    normals = np.eye(3) if lamp.turns else lamp.beam[None]
    rings = [lamp.position[None]]
    for normal in normals:
        first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        first = first / np.linalg.norm(first)
        rings.append(lamp.position + circle @ np.stack([first, np.cross(normal, first)]))
    return np.concatenate(rings)


def _outwards(lamp: PlacedLamp) -> float:
    return float(lamp.beam @ OUTWARD[lamp.face])


def _place(lamp: PlacedLamp) -> str:
    return f"{lamp.key} at ({', '.join(f'{value:g}' for value in lamp.position)}) mm"
