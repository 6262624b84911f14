"""Which of the camera's pixels show which facet through the refracting face.

Sites here are all that the file declares; `render.geometry.seen_sites` says which of them count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry.camera_rays import camera_origin, camera_rays, pixel_directions
from render.geometry.chart import SkinChart
from render.geometry.layout import declared_sites, facets
from render.geometry.refraction import PadRays, distance_to_coating, refract_into_pad
from render.scene import Scene

Index = NDArray[np.int64]

BACKGROUND_RADIUS = 0.7
"""Radius of a site's background spot in units of the pyramid's radius."""
MANY_PIXELS, BLOCK = 1_000_000, 16
"""Pixels of a camera from which on blocks of so many by so many are looked at first."""
RAYS = 8192
"""Rays that meet a pyramid at a time, which bounds the memory."""


@dataclass(frozen=True)
class FacetMasks:
    """The pixels that show nothing but one target.

    Target ``site * (facets + 1) + facet`` owns ``pixel[offset[target]:offset[target + 1]]``;
    facet index ``facets`` is the site's background spot on the untouched pad. Pixels are numbered
    ``row * columns + column``. A target without pixels is not seen by the camera: mask it.
    """

    columns: int
    rows: int
    pixel: Index
    offset: Index
    sites: int
    facets: int

    @property
    def counts(self) -> Index:
        """Number of pixels per target, ``(site, facet + 1)``."""
        return np.diff(self.offset).reshape(self.sites, self.facets + 1)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Whether the camera sees a facet, ``(site, facet)``."""
        return np.asarray(self.counts[:, :-1] > 0)

    def of(self, site: int, facet: int) -> Index:
        """Return the pixels of one facet, or of the background when ``facet == facets``."""
        target = site * (self.facets + 1) + facet
        return self.pixel[self.offset[target] : self.offset[target + 1]]


def facet_masks(
    scene: Scene,
    bend: float,
    *,
    columns: int | None = None,
    rows: int | None = None,
    margin: float = 0.15,
    samples: int = 3,
) -> FacetMasks:
    """Return the pixels of every facet and background spot at ``bend`` radians.

    A pixel belongs to a facet when all its ``samples x samples`` rays meet that facet first, and
    within the facet shrunk by ``margin`` towards its centroid. It belongs to a background spot
    when they all meet the untouched coating within 0.7 pyramid radii of the site's center.
    """
    columns, rows = columns or scene.camera.columns, rows or scene.camera.rows
    if columns * rows > MANY_PIXELS:
        candidates = _pixels_near_sites(scene, bend, columns, rows)
        column, row = (part.astype(np.float64) for part in np.divmod(candidates, columns)[::-1])
        directions = pixel_directions(scene, columns, rows, column + 0.5, row + 0.5)
    else:
        candidates = np.arange(columns * rows)
        directions = camera_rays(scene, columns, rows)[1].reshape(-1, 3)
    center_rays = refract_into_pad(scene, bend, camera_origin(scene), directions)
    # A pixel whose center ray passes no site cannot have all its rays on one target.
    close = (_distance_to_sites(scene, bend, center_rays) < _bounding_radius(scene)).any(axis=0)
    pixels = candidates[close & center_rays.inside]
    owners, owned = _owned_pixels(scene, bend, pixels, (columns, rows), margin, samples)
    order = np.lexsort((owned, owners))
    targets = scene.sites.count * (scene.indenter.faces + 1)
    offset = np.concatenate([[0], np.cumsum(np.bincount(owners, minlength=targets))])
    return FacetMasks(columns, rows, owned[order], offset, scene.sites.count, scene.indenter.faces)


def _pixels_near_sites(scene: Scene, bend: float, columns: int, rows: int) -> Index:
    """Return pixels, ascending, among which are all whose center ray passes a site.

    Blocks of pixels are kept by the ray of their middle. How far rays of one block differ from it
    is taken from its neighbors, and a ring of blocks is kept around all that come close.
    """
    blocks_x, blocks_y = -(-columns // BLOCK), -(-rows // BLOCK)
    row, column = np.meshgrid(
        (np.arange(blocks_y) + 0.5) * BLOCK, (np.arange(blocks_x) + 0.5) * BLOCK, indexing="ij"
    )
    directions = pixel_directions(scene, columns, rows, column, row).reshape(-1, 3)
    rays = refract_into_pad(scene, bend, camera_origin(scene), directions)
    near = np.zeros((blocks_y, blocks_x), dtype=bool)
    for distance in _distance_to_sites(scene, bend, rays).reshape(-1, blocks_y, blocks_x):
        padded = np.pad(distance, 1, mode="edge")
        slack = np.zeros_like(distance)
        for beside in (padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]):
            np.maximum(slack, np.abs(beside - distance), out=slack)
        near |= distance < _bounding_radius(scene) + 2 * slack
    ring = np.pad(near, 1)
    grown = np.zeros_like(near)
    for down in range(3):
        for right in range(3):
            grown |= ring[down : down + blocks_y, right : right + blocks_x]
    wanted = np.repeat(np.repeat(grown, BLOCK, axis=0), BLOCK, axis=1)[:rows, :columns]
    return np.nonzero(wanted.ravel())[0]


def shown_targets(
    scene: Scene, bend: float, pixels: Index, *, margin: float = 0.15, samples: int = 3
) -> Index:
    """Return the targets that have one of ``pixels`` of the camera's own size for themselves.

    As `facet_masks` would say, which takes all pixels.
    """
    size = scene.camera.columns, scene.camera.rows
    return np.unique(_owned_pixels(scene, bend, pixels, size, margin, samples)[0])


def _owned_pixels(
    scene: Scene, bend: float, pixels: Index, size: tuple[int, int], margin: float, samples: int
) -> tuple[Index, Index]:
    """Return the targets that have pixels for themselves, and these pixels, both ``(pair,)``."""
    columns, rows = size
    steps = (np.arange(samples) + 0.5) / samples
    step_y, step_x = (step.ravel() for step in np.meshgrid(steps, steps, indexing="ij"))
    fine = pixel_directions(
        scene,
        columns,
        rows,
        (pixels % columns)[:, None] + step_x,
        (pixels // columns)[:, None] + step_y,
    )
    rays = refract_into_pad(scene, bend, camera_origin(scene), fine.reshape(-1, 3))
    per_pixel = (len(pixels), samples**2)
    target = first_facet(scene, bend, rays, margin).reshape(per_pixel)
    facet_of = np.where((target == target[:, :1]).all(axis=1), target[:, 0], -1)
    spot = _background_spot(scene, bend, rays).reshape(per_pixel)
    spot_of = np.where((spot == spot[:, :1]).all(axis=1), spot[:, 0], -1)
    owners = np.concatenate([facet_of, spot_of])
    return owners[owners >= 0], np.concatenate([pixels, pixels])[owners >= 0]


def _bounding_radius(scene: Scene) -> float:
    """Return the radius (mm) of a sphere about a site that holds its whole pyramid."""
    return max(scene.indenter.radius, scene.indenter.depth)


def _distance_to_sites(scene: Scene, bend: float, rays: PadRays) -> Array:
    """Return the distance (mm) of every site from every ray's line, ``(site, ray)``."""
    distances = []
    for position in facets(scene, bend).site_position:
        to_site = position - rays.entry
        along = np.einsum("ri,ri->r", to_site, rays.direction)
        squared = np.einsum("ri,ri->r", to_site, to_site) - along**2
        distances.append(np.sqrt(np.maximum(squared, 0.0)))
    return np.stack(distances)


def first_facet(scene: Scene, bend: float, rays: PadRays, margin: float) -> Index:
    """Return the target that each ray ``(ray,)`` meets first, -1 for none or its margin."""
    corners, faces = facets(scene, bend).corners, scene.indenter.faces
    nearest = distance_to_coating(scene, bend, rays) + 1e-9
    target = np.full(nearest.shape, -1)
    near = _distance_to_sites(scene, bend, rays) < _bounding_radius(scene)
    for site in range(scene.sites.count):
        meeting = np.nonzero(near[site] & rays.inside)[0]
        for first in range(0, len(meeting), RAYS):
            chosen = meeting[first : first + RAYS]
            distances, weights = _meet_triangles(rays[chosen], corners[site])
            facet = distances.argmin(axis=1)[:, None]
            distance = np.take_along_axis(distances, facet, axis=1)[:, 0]
            within = np.take_along_axis(weights, facet, axis=1)[:, 0] >= margin / 3
            closer = distance < nearest[chosen]
            nearest[chosen[closer]] = distance[closer]
            met = np.where(within, site * (faces + 1) + facet[:, 0], -1)
            target[chosen[closer]] = met[closer]
    return target


def _meet_triangles(rays: PadRays, corners: Array) -> tuple[Array, Array]:
    """Return the way (mm) to triangles seen from their front, and smallest barycentric weights.

    Both ``(ray, triangle)``; Moeller and Trumbore 1997. The way is inf where a ray misses or comes
    from behind.
    """
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(rays.direction[:, None], edge2)
    # Corners run so that the normal faces the camera; a ray from the front has a positive one.
    determinant = np.einsum("rti,ti->rt", p, edge1)
    front = determinant > 1e-12
    safe = np.where(front, determinant, 1.0)
    offset = rays.entry[:, None] - corners[:, 0]
    u = np.einsum("rti,rti->rt", offset, p) / safe
    q = np.cross(offset, edge1)
    v = np.einsum("ri,rti->rt", rays.direction, q) / safe
    smallest = np.minimum(np.minimum(u, v), 1.0 - u - v)
    way = np.einsum("rti,ti->rt", q, edge2) / safe
    return np.where(front & (smallest >= 0.0), way, np.inf), smallest


def _background_spot(scene: Scene, bend: float, rays: PadRays) -> Index:
    """Return the background target on whose spot each ray ``(ray,)`` meets the untouched pad."""
    distance = distance_to_coating(scene, bend, rays)
    met = rays.inside & np.isfinite(distance)
    point = rays.entry + np.where(met, distance, 0.0)[:, None] * rays.direction
    flat = SkinChart(scene, bend).uv(point)
    target = np.full(met.shape, -1)
    faces = scene.indenter.faces
    for site, center in enumerate(declared_sites(scene)[:, :2]):
        distance_to_center = np.hypot(*(flat - center).T)
        on_spot = met & (distance_to_center <= BACKGROUND_RADIUS * scene.indenter.radius)
        target[on_spot] = site * (faces + 1) + faces
    return target
