"""Interreflected light on skin of any slope, for pictures of a height map.

The light that a slope gets is a smooth function of its normal: irradiance of light that has been
diffused once is a quadratic in the normal to 1 % (Ramamoorthi and Hanrahan 2001). It is solved on a
dome of normals at the middle of what is pressed in; what it adds to the light on the untouched
coating is fitted and evaluated per pixel.
"""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.geometry import HeightMap, Imprint
from render.preview.shading_points import ShadingPoints
from render.scene import Scene

DOME_SLOPES = np.radians([20.0, 40.0, 60.0, 75.0])
DOME_AZIMUTHS = 8


def sloped_skin(scene: Scene, skin: HeightMap) -> Imprint:
    """Return faces of all slopes at the middle of the pressed part, half as deep as its deepest."""
    low_x, low_y, high_x, high_y = skin.bounds
    azimuth = 2 * np.pi * np.arange(DOME_AZIMUTHS) / DOME_AZIMUTHS
    slope, turn = (part.ravel() for part in np.meshgrid(DOME_SLOPES, azimuth))
    normal = np.stack(
        [np.sin(slope) * np.sin(turn), np.sin(slope) * np.cos(turn), -np.cos(slope)], axis=-1
    )
    middle = np.tile([0.0, 0.0, -0.5 * skin.deepest], (len(normal), 1))
    center = np.array([0.5 * (low_x + high_x), 0.5 * (low_y + high_y), scene.pad.thickness])
    distance = np.einsum("ki,ki->k", normal, middle)
    upright = np.eye(3)[None]
    return Imprint(center[None], upright, 1, 1, 1.0, normal, distance, middle, skin.size)


def slope_terms(points: ShadingPoints, added: Array) -> Array:
    """Return the weights ``(3, 1, 5)`` of x, y, x x, x y, y y of the normal for ``added`` light.

    ``added`` ``(3, 1, face)`` is what the faces of `sloped_skin` get more than the coating there.
    """
    x, y, _ = points.normal[: points.facets].T
    basis = np.stack([x, y, x * x, x * y, y * y], axis=-1)
    return np.asarray(np.linalg.lstsq(basis, added[:, 0].T, rcond=None)[0].T[:, None])
