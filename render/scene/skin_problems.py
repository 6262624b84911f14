"""What cannot stand beside a skin that is not flat: bends, diffusers, lamps above it, probes."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from render.scene.lamps import EDGES, FACES, PlacedLamp
from render.scene.parts import Bending, Diffuser, Indenter, Pad, Sites
from render.scene.skin import Skin

STEEPEST_FACET = math.radians(85.0)
"""Slope of the skin and of a facet on it, together, at most."""


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
