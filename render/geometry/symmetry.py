"""Mirror symmetry of a sensor in the plane x = 0, and what it says about transport.

A pad that is the same on both sides sees its mirrored twin's light: the average of both is the
same estimate with half the variance.
"""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.geometry.lamp_poses import MirrorTwins, mirror_twins
from render.geometry.seen_sites import counted_sites
from render.geometry.states import in_state
from render.scene import Scene


def is_mirror_symmetric(scene: Scene, phi: Array) -> bool:
    """Return whether sensor and directions ``phi`` ``(fiber, node)`` rad are mirror-symmetric."""
    twins = _twins(scene)
    return twins is not None and bool(np.allclose(phi, _mirrored_phi(twins, phi), atol=1e-12))


def with_mirror_images(scene: Scene, phi: Array) -> tuple[Array, np.ndarray]:
    """Return ``phi`` ``(fiber, node)`` rad joined by its mirror images, and where ``phi`` stands.

    The first array, ``(fiber, 2 node)``, is mirror-symmetric; the second is the index in it of
    every entry of ``phi``. A sensor without twins gets ``phi`` itself.
    """
    count, twins = phi.shape[1], _twins(scene)
    if twins is None:
        return phi, np.broadcast_to(np.arange(count), phi.shape)
    both = np.concatenate([phi, _mirrored_phi(twins, phi)], axis=1)
    # Sorted, sides have equal lists, and at the tip the order turns round as the angles do.
    order = np.argsort(both, axis=1)
    return np.take_along_axis(both, order, axis=1), np.argsort(order, axis=1)[:, :count]


def camera_is_symmetric(scene: Scene) -> bool:
    """Return whether the mirror in x = 0 maps the camera onto itself, but for left and right."""
    right, _, ahead = scene.camera.axes
    return scene.camera.place[0] == ahead[0] == 0.0 and abs(right[0]) in (0.0, 1.0)


def skin_is_symmetric(scene: Scene) -> bool:
    """Return whether the mirror in x = 0 maps the skin onto itself."""
    if scene.skin is None:
        return True
    heights = scene.skin.rise(*scene.skin.grid(scene.pad.width, scene.pad.length))
    return bool(np.allclose(heights, heights[:, ::-1], atol=1e-9))


def states_are_symmetric(scene: Scene) -> bool:
    """Return whether the mirror maps skin and sites onto themselves in every named state."""
    if scene.states is None:
        return True
    sensors = [in_state(scene, state)[0] for state in scene.state_axis]
    return all(skin_is_symmetric(one) and _sites_are_symmetric(one) for one in sensors)


def _twins(scene: Scene) -> MirrorTwins | None:
    if scene.states is not None:
        each = [_twins(in_state(scene, state)[0]) for state in scene.state_axis]
        return None if None in each else each[0]
    if not camera_is_symmetric(scene) or not skin_is_symmetric(scene):
        return None
    if not _sites_are_symmetric(scene):
        return None
    counted = counted_sites(scene)
    alike = scene.sites.centre_x == 0.0 and np.isin(_mirrored_sites(scene)[counted], counted).all()
    return mirror_twins(scene) if alike else None


def _sites_are_symmetric(scene: Scene) -> bool:
    """Return whether a state carries sites and their mirror images to mirrored places."""
    if scene.sites.carried is None:
        return True
    twin, [x, y] = _mirrored_sites(scene), scene.sites.places.T
    both = np.stack([x + x[twin], y - y[twin], scene.sites.turns + scene.sites.turns[twin]])
    return bool(np.abs(both).max() < 1e-9)


def _mirrored_sites(scene: Scene) -> np.ndarray:
    """Return, per declared site, the number of its mirror image."""
    grid = np.arange(scene.sites.count).reshape(scene.sites.rows, scene.sites.columns)
    return grid[:, ::-1].ravel()


def _mirrored_phi(twins: MirrorTwins, phi: Array) -> Array:
    """Return the directions of the mirrored sensor; at the tip phi turns into pi - phi."""
    twin = phi[twins.twin]
    twin[twins.flips] = np.pi - twin[twins.flips][:, ::-1]
    return np.asarray(twin)


def mirror_image(scene: Scene, values: Array, *, facets: bool) -> Array:
    """Return the values of the mirrored cells.

    ``values`` is ``(..., fiber, node, bend, site[, facet])``; of a mirror-symmetric sensor.
    """
    twins = mirror_twins(scene)
    assert twins is not None
    axis = values.ndim - (5 if facets else 4)
    moved = np.moveaxis(values, axis, 0)[twins.twin]
    # Behind the fiber axis: (..., node, bend, site[, facet]).
    nodes = moved.ndim - (4 if facets else 3)
    moved[twins.flips] = np.flip(moved[twins.flips], axis=nodes)
    counted = counted_sites(scene)
    twin = np.searchsorted(counted, _mirrored_sites(scene)[counted])
    moved = np.take(moved, twin, axis=moved.ndim - (2 if facets else 1))
    if facets:
        faces = scene.indenter.faces
        moved = np.take(moved, -np.arange(faces) % faces, axis=-1)
    return np.moveaxis(moved, 0, axis)
