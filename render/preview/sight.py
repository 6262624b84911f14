"""What the pixels of a picture see: places on the skin, and how light there becomes the picture.

Pixels are points like those of `render.preview.shading_points`, at which the same shader evaluates
direct light. What interreflection adds is looked up on the coating's patches and the bodies' faces.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry import SkinChart
from render.preview.sloped_skin import slope_basis
from render.scene import Coating, Scene


@dataclass(frozen=True, eq=False)
class Sight:
    """What one picture sees of the pad, per pixel that sees it.

    Arguments:
        scene: the sensor.
        size: columns and rows of the picture.
        pixel: ``(seen,)`` numbers of the pixels, row by row from the base.
        position: ``(seen, 3)`` mm in flat coordinates.
        facing: ``(seen, 3)`` local unit normals into the pad.
        passed: ``(seen,)`` transmittance of the lower face.
        facet: ``(seen,)`` face of the body that is seen, -1 beside it.
        site: ``(seen,)`` number of the nearest body.
        from_body: ``(seen, 3)`` mm from its center, in its frame.
        to_camera: ``(seen, 3)`` local unit directions to the camera, inside the pad, on a skin with
            a lobe; else None.
    """

    scene: Scene
    size: tuple[int, int]
    pixel: NDArray[np.int64]
    position: Array
    facing: Array
    passed: Array
    facet: NDArray[np.int64]
    site: NDArray[np.int64]
    from_body: Array
    to_camera: Array | None = None

    def picture(self, light: Array, coating: Coating) -> NDArray[np.float32]:
        """Return radiance ``(row, column, 3)``, row 0 at the tip, of irradiance ``(3, seen)``.

        ``coating`` is of one albedo.
        """
        columns, rows = self.size
        picture = np.zeros((rows * columns, len(light)), dtype=np.float32)
        picture[self.pixel] = (light * (coating.reflectance * self._scale)).T
        return picture.reshape(rows, columns, -1)[::-1].copy()

    def on_coating(self, light: Array) -> Array:
        """Return what patches ``(3, row, column)`` of the coating have at the pixels."""
        corners, weights = self._between(light.shape[1:])
        return np.asarray((light.reshape(len(light), -1)[:, corners] * weights).sum(axis=1))

    def on_facets(self, coating: Array, facet: Array) -> Array:
        """Return `on_coating`, and on bodies what their faces ``(3, site, facet)`` have."""
        light, on = self.on_coating(coating), self.facet >= 0
        light[:, on] = facet[:, self.site[on], self.facet[on]]
        return light

    def on_slopes(self, coating: Array, terms: Array) -> Array:
        """Return `on_coating`, and what slopes add by ``terms`` ``(3, 5)`` (`slope_terms`)."""
        return np.maximum(self.on_coating(coating) + terms @ self._slopes.T, 0.0)

    @cached_property
    def _scale(self) -> Array:
        """Radiance at the camera per radiosity of the skin, ``(seen,)``."""
        return self.passed / (np.pi * self.scene.pad.index**2)

    @cached_property
    def _slopes(self) -> Array:
        """Basis of `slope_terms` at the pixels, in the frames of the untouched skin."""
        normal = self.facing
        if self.scene.skin is not None:
            frames = SkinChart(self.scene, 0.0).frames(self.position[:, :2])
            normal = np.einsum("nij,ni->nj", frames, normal)
        return slope_basis(normal)

    def _between(self, shape: tuple[int, ...]) -> tuple[NDArray[np.int64], Array]:
        """Return the four nearest of ``shape`` patches and their weights, both ``(4, seen)``.

        Bilinear, and constant beyond the middles of the outermost patches.
        """
        rows, columns = shape
        sides = np.array([self.scene.pad.width, self.scene.pad.length])
        at = (self.position[:, :2] / sides + 0.5) * [columns, rows] - 0.5
        at = np.clip(at, 0.0, np.array([columns, rows]) - 1.0)
        low = np.minimum(at.astype(np.int64), np.maximum(np.array([columns, rows]) - 2, 0))
        (x, y), (u, v) = low.T, (at - low).T
        right, up = np.minimum(x + 1, columns - 1), np.minimum(y + 1, rows - 1)
        corners = np.stack([y * columns + x, y * columns + right, up * columns + x,
                            up * columns + right])  # fmt: skip
        return corners, np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
