"""Irradiance on facets, rings before them and spots: from the layer, and from each other.

What comes of the exit field straight (`gathering`) and how much points get of the coating's patches
is followed once, whatever the albedo of the coating and the light that arrives by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from render.arrays import Array
from render.finished_parts import FinishedParts
from render.geometry import counted_sites
from render.preview.converged.arrivals import Arrivals
from render.preview.converged.block import face_grid, orthonormal_terms, patch_counts
from render.preview.converged.color_noise import Halved, halved_product, halved_sum
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
from render.preview.facet_blur import ring_count
from render.progress import Clock
from render.scene import Scene

BATCH = 16
"""Starts that are multiplied with the exit field at a time, which bounds the memory."""
PRODUCTS = ("direct", "direct_difference", "ends", "ends_difference")
"""Names under which a batch of `Products` is kept."""
MINOR = 8
"""Patches and rings of coating, which count little, have so many times fewer paths than facets."""


def field_of(arrived: Halved[Arrivals], name: str) -> Halved[Array]:
    """Return one field of what arrives."""
    return Halved(getattr(arrived.whole, name), getattr(arrived.difference, name))


class Products(NamedTuple):
    """Mean radiance from the layer ``(item, column)``, and parts of it from patches."""

    direct: Halved[Array]
    ends: Halved[Array]


def irradiance(
    products: Products, arrived: Halved[Array], sent: list[Halved[Array]]
) -> list[Halved[Array]]:
    """Return that of items in the shape of ``arrived``, ``(..., column)``, by albedo.

    In 1/mm^2 per unit power; ``sent`` ``(patch, column)`` is what the patches send.
    """
    shape = arrived.whole.shape
    flat = Halved(*(each.reshape(products.direct.whole.shape) for each in arrived))
    direct = halved_sum(products.direct, flat)
    lit = (halved_sum(direct, halved_product(products.ends, each)) for each in sent)
    return [Halved(*((np.pi * each).reshape(shape) for each in one)) for one in lit]


class Gathering:
    """What points of one pad, pressed or untouched, get of its lamps' exit field and each other.

    ``count`` paths start at every facet and spot.
    """

    def __init__(
        self, scene: Scene, bend: float, block: Block, field: Halved[Array], count: int,
        clock: Clock, pool: ThreadPoolExecutor, sights: Array | None, seed: int,
        parts: FinishedParts,
    ) -> None:  # fmt: skip
        self._parts = parts
        self._scene, self._bend, self._block, self._field = scene, bend, block, field
        self._count, self._few = count, max(count // MINOR, 1)
        self._clock, self._pool, self._sights, self._seed = clock, pool, sights, seed
        self._grid: FaceGrid | None = face_grid(scene) if len(field.whole) else None
        self._terms = None if self._grid is None else orthonormal_terms(self._grid)
        columns, rows = patch_counts(scene)
        self._patches = columns * rows
        self._of_patches = self._products(
            "patches",
            range(self._patches),
            lambda i: patch_points(scene, block, i, self._few, seed),
        )

    def sent(self, arrived: Halved[Arrivals]) -> list[Halved[Array]]:
        """Return what patches send of all light ``(patch, column)``, by albedo of the coating."""
        direct, ends = self._of_patches
        lit = halved_sum(direct, field_of(arrived, "patches"))
        sent = list[Halved[Array]]()
        for albedo in self._scene.albedos:
            system = np.eye(self._patches) - albedo * ends.whole
            whole = np.linalg.solve(system, albedo * lit.whole)
            changed = lit.difference + ends.difference @ whole
            sent.append(
                Halved(np.asarray(whole), np.asarray(np.linalg.solve(system, albedo * changed)))
            )
        return sent

    def facets(self) -> Products:
        """Return that of facets ``(site * facet, column)``."""
        faces, sites = self._scene.indenter.faces, counted_sites(self._scene)
        return self._products(
            "facets",
            range(len(sites) * faces),
            lambda i: facet_points(
                self._scene,
                self._bend,
                sites[i // faces],
                i % faces,
                self._count,
                self._onto(i // faces, i % faces),
                self._seed,
            ),
            ticks=True,
        )

    def rings(self) -> Products:
        """Return that of the coating before facets ``(site * ring * facet, column)``."""
        faces, sites = self._scene.indenter.faces, counted_sites(self._scene)
        rings = ring_count(self._scene)

        def starts(i: int) -> Starts:
            site, part = divmod(i, rings * faces)
            ring, facet = divmod(part, faces)
            return site_points(
                self._scene, self._bend, sites[site], facet, self._few, self._onto(site, faces),
                self._seed, ring,
            )  # fmt: skip

        return self._products("rings", range(len(sites) * rings * faces), starts)

    def sites(self) -> Products:
        """Return that of the spots ``(site, column)``."""
        sites = counted_sites(self._scene)
        return self._products(
            "sites",
            range(len(sites)),
            lambda i: site_points(
                self._scene,
                self._bend,
                sites[i],
                None,
                self._count,
                self._onto(i, self._scene.indenter.faces + 1),
                self._seed,
            ),
            ticks=True,
        )

    def _onto(self, index: int, part: int) -> Array:
        """Return lines of sight ``(sight, 3)`` onto a part of a site that counts, if any."""
        return NO_SIGHTS if self._sights is None else self._sights[index, part]

    def _products(
        self, name: str, items: range, starts: Callable[[int], Starts], ticks: bool = False
    ) -> Products:
        """Return what ``items`` get of the exit field and of patches; kept by ``name``."""

        def one(i: int) -> Halved[Gathered]:
            found = gathered(starts(i), self._block, self._grid, self._patches, self._terms)
            if ticks:
                self._clock.tick()
            return found

        def batch(numbers: range) -> dict[str, Array]:
            found = list(self._pool.map(one, numbers))
            halves = [*zip(*found, strict=True)]
            terms = Halved(*(np.stack([one.terms for one in half]) for half in halves))
            ends = Halved(*(np.stack([one.patches for one in half]) for half in halves))
            direct = halved_product(terms, self._field)
            return dict(zip(PRODUCTS, (*direct, *ends), strict=True))

        batches = []
        for first in range(0, len(items), BATCH):
            numbers, kept = items[first : first + BATCH], f"{name}-{first}"
            found = self._parts.load(kept)
            if found is None:
                found = batch(numbers)
                self._parts.save(kept, found)
            elif ticks:
                self._clock.skip(len(numbers))
            batches.append(found)
        whole = [np.concatenate([found[part] for found in batches]) for part in PRODUCTS]
        return Products(Halved(*whole[:2]), Halved(*whole[2:]))
