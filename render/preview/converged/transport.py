"""Converged transport of a pad at one bend.

Light that a diffuser has scattered widely is a product, T = U H: ``U`` is what leaves the layer
(`exit_field`), ``H`` what a facet gets of it (`gathering`). Other light is too narrow for the terms
of U: `arrivals` follows it to the coating, and ``H`` has what the coating sends on. The camera
mixes facets as in the shader's preview (`render.preview.facet_blur`).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.errors import SceneError
from render.geometry import counted_sites, flat_fiber_poses
from render.preview.beams import shines_past_layers
from render.preview.bonded import with_bonded_window
from render.preview.converged.arrivals import (
    PHOTONS_AT_A_TIME,
    Arrivals,
    arrivals,
    no_arrivals,
    receivers_at,
)
from render.preview.converged.block import (
    bent_block,
    cell_count,
    face_grid,
    patch_counts,
    term_count,
    wide_from,
)
from render.preview.converged.exit_field import exit_field
from render.preview.converged.gathering import (
    Gathered,
    Starts,
    facet_points,
    gathered,
    patch_points,
    site_points,
)
from render.preview.converged.walks import Block, FaceGrid
from render.preview.facet_blur import facet_blur
from render.progress import Clock
from render.scene import Scene

BATCH = 16
"""Starts that are multiplied with the exit field at a time, which bounds the memory."""
MINOR = 8
"""Patches and feet of facets, which count little, have so many times fewer paths than facets."""
FIELD_COST = 2
"""Times that a photon of an exit field takes longer than a path from a facet."""
FEWEST_ARRIVALS = 1000
"""Photons of a lamp at least."""
WALKING = 3
"""So many times fewer arrivals where there is a diffuser, in which photons walk for long."""


@dataclass(frozen=True)
class Effort:
    """Light paths: ``photons`` of a lamp for its exit field, ``paths`` from a facet.

    ``arrivals`` are photons for all light that is too narrow for it, of all lamps at all bends.
    """

    photons: int = 200_000
    paths: int = 32_768
    arrivals: int = 20_000_000


def spreads(scene: Scene) -> NDArray[np.bool_]:
    """Return ``(lamp,)`` whether a lamp shines through the diffuser: its exit field is made."""
    return flat_fiber_poses(scene).layer > 0.0


def flies(scene: Scene) -> NDArray[np.bool_]:
    """Return ``(lamp,)`` whether some of a lamp's light is too narrow for the exit field."""
    return ~spreads(scene) | (wide_from(scene) > 0) | shines_past_layers(scene)


def task_count(scene: Scene, effort: Effort) -> int:
    """Return the ticks of the clock that `transport_at` takes for one bend.

    One for every facet and spot; for lamps as many as their light takes so many times longer.
    """
    lamps = int(spreads(scene).sum()) * _field_ticks(effort)
    batches = -(-_flown(scene, effort) // PHOTONS_AT_A_TIME)
    lamps += int(flies(scene).sum()) * batches * _batch_ticks(scene, effort)
    return lamps + len(counted_sites(scene)) * (scene.indenter.faces + 1)


def _field_ticks(effort: Effort) -> int:
    return max(1, round(FIELD_COST * effort.photons / effort.paths))


def _batch_ticks(scene: Scene, effort: Effort) -> int:
    cost = WALKING if scene.diffuser else 1
    return max(1, round(cost * PHOTONS_AT_A_TIME / effort.paths))


def _flown(scene: Scene, effort: Effort) -> int:
    """Return the photons of a lamp at one bend whose light is too narrow for the exit field."""
    shares = max(1, int(flies(scene).sum()) * len(scene.bending.angles))
    return max(FEWEST_ARRIVALS, effort.arrivals // shares // (WALKING if scene.diffuser else 1))


class ConvergedTransport(NamedTuple):
    """Transport at one bend: radiance at the camera in 1/(mm^2 sr) per unit power.

    Arguments:
        cells: ``(lamp, node, site, facet + 1)``, the last of the untouched pad.
        grain: ``(lamp, node)``: the variance of a cell is about the grain times it; 0 for lamps
            all of whose light has an exit field, whose noise is about 1 % everywhere.
    """

    cells: Array
    grain: Array


def transport_at(
    scene: Scene, bend: float, phi: Array, effort: Effort, clock: Clock
) -> ConvergedTransport:
    """Return transport at one bend, the same for any number of threads.

    Arguments:
        scene: the sensor.
        bend: rad in [0, pi].
        phi: ``(node,)`` rad.
        effort: how many paths.
        clock: is ticked, `task_count` times in all.

    Raises:
        SceneError: the skin is not flat.
    """
    if scene.skin is not None:
        raise SceneError(
            f"skin.shape = {scene.skin.shape}: the converged preview follows light to flat skins "
            "alone, allowed: no skin; use the preview as drawn (--coarse), or render",
            field="skin",
        )
    if not scene.window_refracts:
        scene = with_bonded_window(scene)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        light = _light(scene, bend, phi, effort, clock, pool)
        pressed = _Gathering(scene, bend, True, light, effort, clock, pool)
        untouched = _Gathering(scene, bend, False, light, effort, clock, pool)
        facet, foot, site = pressed.facets(), pressed.feet(), untouched.sites()
    blur = facet_blur(scene, bend)
    mixed, around = blur[:, :-1, :-1], blur[:, :-1, -1, None]
    cells = np.einsum("sij,sjr->sir", mixed, facet) + around * foot
    background = blur[:, -1, -1:, None] * site[:, None]
    cells = np.concatenate([cells, background], axis=1)
    out = np.empty((scene.lamp_count, len(phi), *cells.shape[:2]))
    grain = np.zeros(out.shape[:2])
    passed = np.pi * float(np.median(blur[:, :-1].sum(axis=-1)))
    for lamp, columns in enumerate(light.columns):
        out[lamp] = np.moveaxis(cells[..., columns], -1, 0)
        grain[lamp] = passed * light.arrived.grain[columns]
    return ConvergedTransport(out, grain)


class _Light(NamedTuple):
    """What leaves the lamps; the last axis is the column.

    Arguments:
        columns: of each lamp, one for every node, or one for all.
        field: ``(cell * term, column)`` the exit field; no cells where no lamp has one.
        arrived: what gets to coating and facets by itself.
    """

    columns: list[slice]
    field: Array
    arrived: Arrivals


def _light(
    scene: Scene, bend: float, phi: Array, effort: Effort, clock: Clock, pool: ThreadPoolExecutor
) -> _Light:
    block, grid = bent_block(scene, bend, pressed=False), face_grid(scene)
    pressed, receivers = bent_block(scene, bend, pressed=True), receivers_at(scene, bend)
    spread, flying = spreads(scene), flies(scene)
    nodes = np.where(flat_fiber_poses(scene).turns, len(phi), 1)
    rows = cell_count(grid) * term_count(grid) if spread.any() else 0

    def field_of(lamp: int) -> Array:
        if not spread[lamp]:
            return np.zeros((rows, nodes[lamp]))
        field = exit_field(scene, bend, lamp, phi, block, grid, effort.photons)
        clock.tick(_field_ticks(effort))
        return field.reshape(rows, -1)

    def arrivals_of(lamp: int) -> Arrivals:
        if not flying[lamp]:
            return no_arrivals(scene, nodes[lamp])
        return arrivals(
            scene, bend, lamp, phi, block, pressed, receivers, _flown(scene, effort),
            after_batch=lambda: clock.tick(_batch_ticks(scene, effort)),
        )  # fmt: skip

    lamps, ends = range(scene.lamp_count), np.cumsum(nodes)
    fields, arrived = list(pool.map(field_of, lamps)), list(pool.map(arrivals_of, lamps))
    return _Light(
        [slice(int(end - count), int(end)) for end, count in zip(ends, nodes, strict=True)],
        np.concatenate(fields, axis=1),
        Arrivals(*(np.concatenate(parts, axis=-1) for parts in zip(*arrived, strict=True))),
    )


class _Gathering:
    """What points of one pad, pressed or untouched, get of ``light``.

    Irradiance in 1/mm^2 per unit power, ``(..., column)``.
    """

    def __init__(
        self, scene: Scene, bend: float, pressed: bool, light: _Light, effort: Effort,
        clock: Clock, pool: ThreadPoolExecutor,
    ) -> None:  # fmt: skip
        self._scene, self._bend, self._effort, self._clock = scene, bend, effort, clock
        self._pool, self._light = pool, light
        self._block: Block = bent_block(scene, bend, pressed)
        self._grid: FaceGrid | None = face_grid(scene) if len(light.field) else None
        columns, rows = patch_counts(scene)
        self._patches = columns * rows
        few = max(effort.paths // MINOR, 1)
        direct, ends = self._products(
            range(self._patches), lambda i: patch_points(scene, self._block, i, few)
        )
        albedo = scene.coating.albedo
        sent = albedo * (direct + light.arrived.patches)
        self._sent = np.linalg.solve(np.eye(self._patches) - albedo * ends, sent)

    def facets(self) -> Array:
        """Return ``(site, facet, column)``."""
        faces, paths = self._scene.indenter.faces, self._effort.paths
        sites = counted_sites(self._scene)
        return self._irradiance(
            lambda i: facet_points(self._scene, self._bend, sites[i // faces], i % faces, paths),
            self._light.arrived.facets,
            ticks=True,
        )

    def feet(self) -> Array:
        """Return ``(site, facet, column)`` on the coating before the facets."""
        faces, few = self._scene.indenter.faces, max(self._effort.paths // MINOR, 1)
        sites = counted_sites(self._scene)
        return self._irradiance(
            lambda i: site_points(self._scene, self._bend, sites[i // faces], i % faces, few),
            self._light.arrived.feet,
        )

    def sites(self) -> Array:
        """Return ``(site, column)`` on the spots."""
        sites, paths = counted_sites(self._scene), self._effort.paths
        return self._irradiance(
            lambda i: site_points(self._scene, self._bend, sites[i], None, paths),
            self._light.arrived.spots,
            ticks=True,
        )

    def _irradiance(
        self, starts: Callable[[int], Starts], arrived: Array, ticks: bool = False
    ) -> Array:
        """Return that of items in the shape of ``arrived``, ``(..., column)``."""
        items = range(int(np.prod(arrived.shape[:-1])))
        direct, ends = self._products(items, starts, ticks)
        direct += arrived.reshape(direct.shape)
        return np.asarray(np.pi * (direct + ends @ self._sent)).reshape(arrived.shape)

    def _products(
        self, items: range, starts: Callable[[int], Starts], ticks: bool = False
    ) -> tuple[Array, Array]:
        """Return mean radiance from the layer ``(item, column)``, and parts of it from patches."""

        def one(i: int) -> Gathered:
            found = gathered(starts(i), self._block, self._grid, self._patches)
            if ticks:
                self._clock.tick()
            return found

        direct, ends = [], []
        for first in range(0, len(items), BATCH):
            found = list(self._pool.map(one, items[first : first + BATCH]))
            direct.append(np.stack([each.terms for each in found]) @ self._light.field)
            ends += [each.patches for each in found]
        return np.concatenate(direct), np.stack(ends)
