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
    NO_SIGHTS,
    Gathered,
    Starts,
    facet_points,
    gathered,
    patch_points,
    site_points,
)
from render.preview.converged.walks import Block, FaceGrid
from render.preview.facet_blur import facet_blurs, lines_of_sight
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
WALKING = 3.0
"""So many times longer photons fly at most where they walk in a diffuser, and are fewer."""


@dataclass(frozen=True)
class Effort:
    """Light paths: ``photons`` of a lamp for its exit field, ``paths`` from a facet.

    ``arrivals`` are photons for all light that is too narrow for it, of all lamps at all bends.
    """

    photons: int = 200_000
    paths: int = 32_768
    arrivals: int = 40_000_000


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
    ticks = lamps + len(counted_sites(scene)) * (scene.indenter.faces + 1)
    return ticks * (1 if scene.coating.lobe is None else len(scene.albedos))


def _field_ticks(effort: Effort) -> int:
    return max(1, round(FIELD_COST * effort.photons / effort.paths))


def _batch_ticks(scene: Scene, effort: Effort) -> int:
    return max(1, round(flight_cost(scene) * PHOTONS_AT_A_TIME / effort.paths))


def flight_cost(scene: Scene) -> float:
    """Return how many times longer photons fly than in a clear pad; most just pass a thin layer."""
    layer = scene.diffuser
    if layer is None:
        return 1.0
    return min(WALKING, 1.0 + (layer.sigma_s + layer.sigma_a) * layer.thickness)


def _flown(scene: Scene, effort: Effort) -> int:
    """Return the photons of a lamp at one bend whose light is too narrow for the exit field."""
    shares = max(1, int(flies(scene).sum()) * len(scene.bending.angles))
    return max(FEWEST_ARRIVALS, int(effort.arrivals // shares / flight_cost(scene)))


class ConvergedTransport(NamedTuple):
    """Transport at one bend: radiance at the camera in 1/(mm^2 sr) per unit power.

    Arguments:
        cells: ``(lamp, node, site, facet + 1)``, the last of the untouched pad.
        grain: ``(lamp, node)``: the variance of a cell is about the grain times it; 0 for lamps
            all of whose light has an exit field, whose noise is about 1 % everywhere.

    Both have one more axis ``channel`` where the skin's albedo depends on it.
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
    if scene.by_channel and scene.coating.lobe is not None:
        # How much of the light is in the lobe differs, so each channel has light paths of its own.
        parts = [transport_at(one, bend, phi, effort, clock) for one in scene.one_albedo_scenes]
        return _by_channel(scene, parts)
    if not scene.window_refracts:
        scene = with_bonded_window(scene)
    sights = None if scene.coating.lobe is None else lines_of_sight(scene, bend)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        light = _light(scene, bend, phi, effort, clock, pool, sights)
        pressed = _Gathering(scene, bend, True, light, effort, clock, pool, sights)
        untouched = _Gathering(scene, bend, False, light, effort, clock, pool, sights)
        irradiance = pressed.facets(), pressed.feet(), untouched.sites()
    parts = [
        _seen(light, len(phi), blur, *lit)
        for blur, *lit in zip(facet_blurs(scene, bend), *irradiance, strict=True)
    ]
    return parts[0] if len(parts) == 1 else _by_channel(scene, parts)


def _by_channel(scene: Scene, parts: list[ConvergedTransport]) -> ConvergedTransport:
    """Return transport with an axis of channels, of that of each albedo."""
    return ConvergedTransport(
        *(
            np.stack([each[albedo] for albedo in scene.albedo_of_channel], axis=-1)
            for each in zip(*parts, strict=True)
        )
    )


def _seen(
    light: _Light, nodes: int, blur: Array, facet: Array, foot: Array, site: Array
) -> ConvergedTransport:
    """Return what the camera sees of the irradiance on facets, their feet and sites."""
    mixed, around = blur[:, :-1, :-1], blur[:, :-1, -1, None]
    cells = np.einsum("sij,sjr->sir", mixed, facet) + around * foot
    background = blur[:, -1, -1:, None] * site[:, None]
    cells = np.concatenate([cells, background], axis=1)
    out = np.empty((len(light.columns), nodes, *cells.shape[:2]))
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
    scene: Scene, bend: float, phi: Array, effort: Effort, clock: Clock, pool: ThreadPoolExecutor,
    sights: Array | None,
) -> _Light:  # fmt: skip
    block, grid = bent_block(scene, bend, pressed=False), face_grid(scene)
    pressed, receivers = bent_block(scene, bend, pressed=True), receivers_at(scene, bend, sights)
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

    Irradiance in 1/mm^2 per unit power, ``(..., column)``, for each albedo of the coating: what
    comes straight and how much points get of each other is followed once.
    """

    def __init__(
        self, scene: Scene, bend: float, pressed: bool, light: _Light, effort: Effort,
        clock: Clock, pool: ThreadPoolExecutor, sights: Array | None,
    ) -> None:  # fmt: skip
        self._scene, self._bend, self._effort, self._clock = scene, bend, effort, clock
        self._pool, self._light, self._sights = pool, light, sights
        self._block: Block = bent_block(scene, bend, pressed)
        self._grid: FaceGrid | None = face_grid(scene) if len(light.field) else None
        columns, rows = patch_counts(scene)
        self._patches = columns * rows
        few = max(effort.paths // MINOR, 1)
        direct, ends = self._products(
            range(self._patches), lambda i: patch_points(scene, self._block, i, few)
        )
        self._sent = [
            np.linalg.solve(
                np.eye(self._patches) - albedo * ends, albedo * (direct + light.arrived.patches)
            )
            for albedo in scene.albedos
        ]

    def facets(self) -> list[Array]:
        """Return ``(site, facet, column)``."""
        faces, paths = self._scene.indenter.faces, self._effort.paths
        sites = counted_sites(self._scene)
        return self._irradiance(
            lambda i: facet_points(
                self._scene,
                self._bend,
                sites[i // faces],
                i % faces,
                paths,
                self._onto(i // faces, i % faces),
            ),
            self._light.arrived.facets,
            ticks=True,
        )

    def feet(self) -> list[Array]:
        """Return ``(site, facet, column)`` on the coating before the facets."""
        faces, few = self._scene.indenter.faces, max(self._effort.paths // MINOR, 1)
        sites = counted_sites(self._scene)
        return self._irradiance(
            lambda i: site_points(
                self._scene,
                self._bend,
                sites[i // faces],
                i % faces,
                few,
                self._onto(i // faces, faces),
            ),
            self._light.arrived.feet,
        )

    def sites(self) -> list[Array]:
        """Return ``(site, column)`` on the spots."""
        sites, paths = counted_sites(self._scene), self._effort.paths
        return self._irradiance(
            lambda i: site_points(
                self._scene,
                self._bend,
                sites[i],
                None,
                paths,
                self._onto(i, self._scene.indenter.faces + 1),
            ),
            self._light.arrived.spots,
            ticks=True,
        )

    def _onto(self, index: int, part: int) -> Array:
        """Return lines of sight ``(sight, 3)`` onto a part of a site that counts, if any."""
        return NO_SIGHTS if self._sights is None else self._sights[index, part]

    def _irradiance(
        self, starts: Callable[[int], Starts], arrived: Array, ticks: bool = False
    ) -> list[Array]:
        """Return that of items in the shape of ``arrived``, ``(..., column)``, by albedo."""
        items = range(int(np.prod(arrived.shape[:-1])))
        direct, ends = self._products(items, starts, ticks)
        direct += arrived.reshape(direct.shape)
        return [
            np.asarray(np.pi * (direct + ends @ sent)).reshape(arrived.shape) for sent in self._sent
        ]

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
