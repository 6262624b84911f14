"""Mirror symmetry of a sensor in the plane x = 0, and what it says about transport.

A pad that is the same on both sides sees its mirrored twin's light: the average of both is the
same estimate with half the variance.
"""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.geometry.layout import fiber_edges, mirrored_fibers
from render.scene import Scene


def is_mirror_symmetric(scene: Scene, phi: Array) -> bool:
    """Return whether sensor and directions ``phi`` ``(fiber, node)`` rad are mirror-symmetric."""
    return _has_twins(scene) and bool(np.allclose(phi, _mirrored_phi(scene, phi), atol=1e-12))


def with_mirror_images(scene: Scene, phi: Array) -> tuple[Array, np.ndarray]:
    """Return ``phi`` ``(fiber, node)`` rad joined by its mirror images, and where ``phi`` stands.

    The first array, ``(fiber, 2 node)``, is mirror-symmetric; the second is the index in it of
    every entry of ``phi``. A sensor without twins gets ``phi`` itself.
    """
    count = phi.shape[1]
    if not _has_twins(scene):
        return phi, np.broadcast_to(np.arange(count), phi.shape)
    both = np.concatenate([phi, _mirrored_phi(scene, phi)], axis=1)
    # Sorted, sides have equal lists, and at the tip the order turns round as the angles do.
    order = np.argsort(both, axis=1)
    return np.take_along_axis(both, order, axis=1), np.argsort(order, axis=1)[:, :count]


def _has_twins(scene: Scene) -> bool:
    return scene.fibers.left == scene.fibers.right and scene.sites.centre_x == 0.0


def _mirrored_phi(scene: Scene, phi: Array) -> Array:
    """Return the directions of the mirrored sensor; at the tip phi turns into pi - phi."""
    twin = phi[mirrored_fibers(scene)]
    tip = np.array([edge == "tip" for edge in fiber_edges(scene)])
    twin[tip] = np.pi - twin[tip][:, ::-1]
    return np.asarray(twin)


def mirror_image(scene: Scene, values: Array, *, facets: bool) -> Array:
    """Return the values of the mirrored cells.

    ``values`` is ``(..., fiber, node, bend, site[, facet])``; of a mirror-symmetric sensor.
    """
    axis = values.ndim - (5 if facets else 4)
    moved = np.moveaxis(values, axis, 0)[mirrored_fibers(scene)]
    tip = np.array([edge == "tip" for edge in fiber_edges(scene)])
    # Behind the fiber axis: (..., node, bend, site[, facet]).
    nodes = moved.ndim - (4 if facets else 3)
    moved[tip] = np.flip(moved[tip], axis=nodes)
    sites = np.arange(scene.sites.count).reshape(scene.sites.rows, scene.sites.columns)
    site_axis = moved.ndim - (2 if facets else 1)
    moved = np.take(moved, sites[:, ::-1].ravel(), axis=site_axis)
    if facets:
        faces = scene.indenter.faces
        moved = np.take(moved, -np.arange(faces) % faces, axis=-1)
    return np.moveaxis(moved, 0, axis)
