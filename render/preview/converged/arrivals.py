"""Light that lamps send to the coating and the facets before the coating has reflected any.

For lamps whose light is too narrow for the exit field: it enters through a clear face, or passes a
thin layer. Analog photons fly through the untouched pad as it is bent. What a facet gets is what
passes near it, taken to be alike within a disk of about the size of the pyramid; its error is of
the second order in that radius. Narrow beams have smaller disks, down to those that spread light as
far as the facet itself does.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from render.arrays import Array
from render.geometry import SkinChart, counted_sites, declared_sites, facets, fiber_poses
from render.geometry.visibility import BACKGROUND_RADIUS
from render.preview.converged.block import (
    beam_widths,
    directions_to_block,
    on_pad,
    patch_areas,
    patch_counts,
    to_block,
)
from render.preview.converged.color_noise import Halved
from render.preview.converged.launching import launched
from render.preview.converged.walks import Block, Receivers, trace_arrivals
from render.preview.facet_blur import RINGS, ring_count
from render.scene import Scene

ARRIVAL_KEY = 5 << 40
"""Family of the streams of photons; lamps are counted from it."""
PHOTONS_AT_A_TIME = 100_000
"""Bounds the memory, and is the step of progress."""
DISK = 1.0
"""Radius within which light is taken to be alike, in radii of the pyramid."""
BEAM_PART = 0.4
"""The same of a narrow beam, in widths of it (`beam_widths`)."""
OWN_DISK = 1.0 / math.sqrt(6.0)
"""Radius of the disk whose points spread as far as those of a facet of a pyramid with six faces, in
radii of the pyramid; that of an untouched spot is its own."""


class Arrivals(NamedTuple):
    """Irradiance over pi, 1/mm^2 per unit power, that the coating has not reflected.

    ``patches`` ``(patch, node)``, ``facets`` ``(site, facet, node)`` and the coating before them,
    ``rings`` ``(site, ring * facet, node)``, on the pressed pad, ``spots`` ``(site, node)`` on the
    untouched one. ``grain`` ``(node,)`` is what one photon is worth to a receiver: the variance of
    an irradiance is about the grain times it.
    """

    patches: Array
    facets: Array
    rings: Array
    spots: Array
    grain: Array


def no_arrivals(scene: Scene, nodes: int) -> Arrivals:
    """Return those of a lamp all of whose light belongs to the exit field."""
    columns, rows = patch_counts(scene)
    sites, faces = len(counted_sites(scene)), scene.indenter.faces
    around = ring_count(scene) * faces
    shapes: tuple[tuple[int, ...], ...]
    shapes = (columns * rows,), (sites, faces), (sites, around), (sites,), ()
    return Arrivals(*(np.zeros((*shape, nodes)) for shape in shapes))


def receivers_at(scene: Scene, bend: float, sights: Array | None = None) -> Receivers:
    """Return facets, rings of coating before them and spots of all sites that count, in this order.

    ``sights`` ``(site, facet + 2, sight, 3)`` are lines of sight onto facets, onto the coating
    before them and onto the spot (`render.preview.facet_blur.lines_of_sight`).
    """
    faces, radius = scene.indenter.faces, scene.indenter.radius
    sites, shape = counted_sites(scene), facets(scene, bend)
    uv, chart = declared_sites(scene)[sites, :2], SkinChart(scene, bend)
    azimuth = 2 * np.pi * (np.arange(faces)[:, None] + [-0.25, 0.25, 0.0]) / faces
    # A state may have turned the sites.
    azimuth = azimuth - scene.sites.turns[sites, None, None]
    bounds = RINGS[: ring_count(scene) + 1]
    out = radius * np.array([[inner, inner, outer] for inner, outer in pairwise(bounds)])
    outward = np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
    before = (out[:, None, :, None] * outward[:, None]).reshape(len(uv), -1, 3, 2)
    rings = chart.points(on_pad(scene, uv[:, None, None] + before))
    inward = -chart.frames(uv)[..., 2]
    spot = np.repeat(shape.site_position[sites][:, None, None], 3, axis=2)
    corners = np.concatenate([shape.corners[sites], rings, spot], axis=1)
    level = np.repeat(inward[:, None], corners.shape[1] - faces, axis=1)
    normal = np.concatenate([shape.normal[sites], level], axis=1)
    center, site = corners.mean(axis=2), shape.site_position[sites]
    parts = center.shape[1]
    apart = np.linalg.norm(center - site[:, None], axis=-1).max()
    return Receivers(
        site=to_block(scene, site),
        inward=directions_to_block(inward),
        center=np.ascontiguousarray(to_block(scene, center)),
        normal=directions_to_block(normal),
        corners=np.ascontiguousarray(to_block(scene, corners)),
        shaded=np.arange(parts) < parts - 1,
        radius=np.full(parts, DISK * radius),
        reach=float(apart) + DISK * radius,
        sights=_onto_receivers(sights, len(sites), faces, parts),
    )


def narrowed(receivers: Receivers, width: float, radius: float) -> Receivers:
    """Return receivers for a beam of a width (mm), at pyramids of a radius (mm)."""
    own = np.full(len(receivers.radius), OWN_DISK * radius)
    own[-1] = BACKGROUND_RADIUS * radius
    disks = np.clip(BEAM_PART * width, own, DISK * radius)
    return receivers._replace(radius=disks)


def _onto_receivers(sights: Array | None, sites: int, faces: int, parts: int) -> Array:
    if sights is None:
        return np.zeros((sites, parts, 0, 3))
    chosen = [*range(faces), *([faces] * (parts - faces - 1)), faces + 1]
    return directions_to_block(sights[:, chosen])


class Flown(NamedTuple):
    """What photons of a lamp bring, not scaled.

    Power of patches ``(patch, node)`` and of receivers ``(site, part, node)``, of all of them and
    of those in the first half of the lamp's photons; ``squares`` ``(node,)`` of what they bring.
    """

    patches: Array
    received: Array
    first_patches: Array
    first_received: Array
    squares: Array

    def __add__(self, other: Flown) -> Flown:  # type: ignore[override]
        """Return what both bring."""
        return Flown(*(mine + its for mine, its in zip(self, other, strict=True)))


def batches(photons: int) -> list[range]:
    """Return the numbers of a lamp's photons, `PHOTONS_AT_A_TIME` together."""
    starts = range(0, photons, PHOTONS_AT_A_TIME)
    return [range(first, min(first + PHOTONS_AT_A_TIME, photons)) for first in starts]


def flown(
    scene: Scene,
    bend: float,
    lamp: int,
    phi: Array,
    block: Block,
    pressed: Block,
    receivers: Receivers,
    photons: int,
    numbers: range,
    seed: int = 0,
) -> Flown:
    """Return what some of a lamp's photons, which have a power of 1 together, bring to a pad.

    Arguments:
        scene: the sensor.
        bend: rad.
        lamp: its number.
        phi: ``(node,)`` rad; a lamp that does not turn has one node.
        block: of the scene at this bend, untouched; ``pressed`` with its pyramids.
        pressed: see ``block``.
        receivers: of the scene at this bend.
        photons: how many share the power.
        numbers: of those that fly.
        seed: of their random numbers.
    """
    columns, rows = patch_counts(scene)
    receivers = narrowed(receivers, float(beam_widths(scene)[lamp]), scene.indenter.radius)
    nodes = len(phi) if fiber_poses(scene, bend).turns[lamp] else 1
    patches, squares = np.zeros((columns * rows, nodes)), np.zeros(nodes)
    received = np.zeros((*receivers.center.shape[:2], nodes))
    key = ARRIVAL_KEY + (seed << 20) + lamp
    origin, direction, weights = launched(scene, bend, lamp, phi, numbers, key)
    weights *= len(numbers) / photons
    origin, direction = to_block(scene, origin), directions_to_block(direction)
    cut = min(max(photons // 2 - numbers.start, 0), len(numbers))
    halves = []
    for rays in (slice(0, cut), slice(cut, len(numbers))):
        trace_arrivals(
            block, pressed, receivers, origin[rays], direction[rays], weights[rays], key,
            numbers.start + rays.start, patches, received, squares,
        )  # fmt: skip
        halves.append((patches.copy(), received.copy()))
    return Flown(*halves[1], *halves[0], squares)


def arrivals(scene: Scene, brought: Flown) -> Halved[Arrivals]:
    """Return what a lamp of unit power sends to all receivers and patches: all of its photons."""
    faces, areas = scene.indenter.faces, patch_areas(scene)
    lit, nodes = brought.received.sum(axis=(0, 1)), len(brought.squares)
    grain = np.divide(brought.squares, lit, out=np.zeros(nodes), where=lit > 0.0) / np.pi

    def scaled(patches: Array, received: Array, grain: Array) -> Arrivals:
        patches, received = patches / (np.pi * areas[:, None]), received / np.pi
        facets, rings = received[:, :faces], received[:, faces:-1]
        return Arrivals(patches, facets, rings, received[:, -1], grain)

    patches, received = brought.patches, brought.received
    differences = 2.0 * brought.first_patches - patches, 2.0 * brought.first_received - received
    return Halved(scaled(patches, received, grain), scaled(*differences, np.zeros(nodes)))
