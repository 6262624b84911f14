"""Interreflected light on skin of any slope, for pictures of a height map.

The light that a slope gets is a smooth function of its normal: irradiance of light that has been
diffused once is a quadratic in the normal to 1 % (Ramamoorthi and Hanrahan 2001). It is solved on a
dome of normals at the middle of what is pressed in; what it adds to the light on the untouched
coating is fitted and evaluated per pixel.
"""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.geometry import HeightMap, Imprint, SkinChart
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
    uv, chart = np.array([[0.5 * (low_x + high_x), 0.5 * (low_y + high_y)]]), SkinChart(scene, 0.0)
    distance = np.einsum("ki,ki->k", normal, middle)
    return Imprint(chart.flat(uv), chart.frames(uv), 1, 1, 1.0, normal, distance, middle, skin.size)


def slope_basis(normal: Array) -> Array:
    """Return x, y, x x, x y, y y ``(..., 5)`` of unit normals ``(..., 3)`` in the skin's frame."""
    x, y = normal[..., 0], normal[..., 1]
    return np.stack([x, y, x * x, x * y, y * y], axis=-1)


def slope_terms(faces: Imprint, added: Array) -> Array:
    """Return the weights ``(3, 5)`` of `slope_basis` for ``added`` light.

    ``added`` ``(3, face)`` is what ``faces`` of `sloped_skin` get more than the coating there.
    """
    basis = slope_basis(faces.normal)
    return np.asarray(np.linalg.lstsq(basis, added.T, rcond=None)[0].T)
