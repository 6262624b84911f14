"""Converged transport as the product of exit field and gathering, T = U H.

``U`` is the light that leaves the diffusive layer (`exit_field`), ``H`` what a facet gets of it
(`gathering`); the camera mixes facets as in the shader's preview (`render.preview.facet_blur`).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.geometry import counted_sites
from render.preview.facet_blur import facet_blur
from render.progress import Clock
from render.scene import Scene
from render.preview.converged.block import bent_block, face_grid, patch_counts
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

BATCH = 16
"""Starts that are multiplied with the exit field at a time, which bounds the memory."""
MINOR = 8
"""Patches and feet of facets, which count little, have so many times fewer paths than facets."""


@dataclass(frozen=True)
class Effort:
    """Light paths: ``photons`` per lamp, ``paths`` per facet."""

    photons: int = 200_000
    paths: int = 32_768


def task_count(scene: Scene) -> int:
    """Return the ticks of the clock that `transport_at` takes for one bend."""
    return scene.lamp_count + len(counted_sites(scene)) * (scene.indenter.faces + 1)


def transport_at(scene: Scene, bend: float, phi: Array, effort: Effort, clock: Clock) -> Array:
    """Return transport at one bend, ``(fiber, node, site, facet + 1)``, the last the background.

    Radiance at the camera in 1/(mm^2 sr) per unit power. The same for any number of threads.

    Arguments:
        scene: the sensor.
        bend: rad in [0, pi].
        phi: ``(node,)`` rad.
        effort: how many paths.
        clock: is ticked for every lamp, facet and spot.
    """
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        light, nodes = _light(scene, bend, phi, effort, clock, pool)
        pressed = _Receivers(scene, bend, True, light, effort, clock, pool)
        untouched = _Receivers(scene, bend, False, light, effort, clock, pool)
        facet, foot, site = pressed.facets(), pressed.feet(), untouched.sites()
    blur = facet_blur(scene, bend)
    mixed, around = blur[:, :-1, :-1], blur[:, :-1, -1, None]
    cells = np.einsum("sij,sjr->sir", mixed, facet) + around * foot
    background = blur[:, -1, -1:, None] * site[:, None]
    cells = np.concatenate([cells, background], axis=1)
    split = np.split(cells, np.cumsum(nodes)[:-1], axis=2)
    every = [np.broadcast_to(part, (*part.shape[:2], len(phi))) for part in split]
    return np.stack(every).transpose(0, 3, 1, 2)


def _light(
    scene: Scene, bend: float, phi: Array, effort: Effort, clock: Clock, pool: ThreadPoolExecutor
) -> tuple[Array, list[int]]:
    """Return the exit field ``(cell * term, column)`` and how many columns each lamp has."""
    block, grid = bent_block(scene, bend, pressed=False), face_grid(scene)

    def of_lamp(lamp: int) -> Array:
        field = exit_field(scene, bend, lamp, phi, block, grid, effort.photons)
        clock.tick()
        return field.reshape(-1, field.shape[-1])

    fields = list(pool.map(of_lamp, range(scene.lamp_count)))
    return np.concatenate(fields, axis=1), [field.shape[1] for field in fields]


class _Receivers:
    """What points of one pad, pressed or untouched, get of the exit field ``light``.

    Irradiance in 1/mm^2 per unit power, ``(..., column)``.
    """

    def __init__(
        self, scene: Scene, bend: float, pressed: bool, light: Array, effort: Effort, clock: Clock,
        pool: ThreadPoolExecutor,
    ) -> None:  # fmt: skip
        self._scene, self._bend, self._effort, self._clock = scene, bend, effort, clock
        self._pool, self._light = pool, light
        self._block: Block = bent_block(scene, bend, pressed)
        self._grid: FaceGrid = face_grid(scene)
        columns, rows = patch_counts(scene)
        self._patches = columns * rows
        few = max(effort.paths // MINOR, 1)
        direct, ends = self._products(
            range(self._patches), lambda i: patch_points(scene, self._block, i, few)
        )
        albedo = scene.coating.albedo
        self._sent = np.linalg.solve(np.eye(self._patches) - albedo * ends, albedo * direct)

    def facets(self) -> Array:
        """Return ``(site, facet, column)``."""
        faces, paths = self._scene.indenter.faces, self._effort.paths
        sites = counted_sites(self._scene)
        found = self._irradiance(
            range(len(sites) * faces),
            lambda i: facet_points(self._scene, self._bend, sites[i // faces], i % faces, paths),
            ticks=True,
        )
        return found.reshape(len(sites), faces, -1)

    def feet(self) -> Array:
        """Return ``(site, facet, column)`` on the coating before the facets."""
        faces, few = self._scene.indenter.faces, max(self._effort.paths // MINOR, 1)
        sites = counted_sites(self._scene)
        found = self._irradiance(
            range(len(sites) * faces),
            lambda i: site_points(self._scene, self._bend, sites[i // faces], i % faces, few),
        )
        return found.reshape(len(sites), faces, -1)

    def sites(self) -> Array:
        """Return ``(site, column)`` on the spots."""
        sites, paths = counted_sites(self._scene), self._effort.paths
        return self._irradiance(
            range(len(sites)),
            lambda i: site_points(self._scene, self._bend, sites[i], None, paths),
            ticks=True,
        )

    def _irradiance(
        self, items: range, starts: Callable[[int], Starts], ticks: bool = False
    ) -> Array:
        direct, ends = self._products(items, starts, ticks)
        return np.asarray(np.pi * (direct + ends @ self._sent))

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
            direct.append(np.stack([each.terms for each in found]) @ self._light)
            ends += [each.patches for each in found]
        return np.concatenate(direct), np.stack(ends)
