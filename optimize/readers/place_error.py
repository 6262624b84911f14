"""Expected error of the *place* reader in closed form, with exact derivatives.

A reader that knows the colors c(n) of all normals at its place misses n by at least what the
Cramer-Rao bound with a prior allows, ``sqrt(pi / 4 tr[(J' V^-1 J + prior)^-1 G])`` with J = dc/dn,
V the noise's variances and G the sphere's metric (van Trees 1968). Normals far apart that have
nearly one color are mistaken for each other: all are answers with weights ``exp(-d^2 / 2)`` of the
distance of their colors in standard deviations of both, the truth's own neighbors among them.
Measured against the lookup itself: `tests/validation/test_readers.py`.
"""

from __future__ import annotations

import numpy as np

from optimize.design import Array
from optimize.readers.camera_model import FULL_SCALE, CameraModel
from optimize.readers.expected_error import ExpectedError
from optimize.readers.normal_colors import color_weights, weight_slopes
from optimize.readers.normals import (
    angle,
    plane_parts,
    sphere_metric,
    spread_normals,
    steepest,
    vectors,
)
from render.scene import Scene

NORMALS = 24
"""Per site and state, the same at all; 48 raise errors by 1 to 6 % and take four times as long.

They rank designs of few lamps a little better (same validation).
"""
FAR = 12.0
"""Degrees from which on two normals are another answer, not a less exact one."""


class PlaceError(ExpectedError):
    """The expected error of one scene's designs, in degrees, from their exposed counts.

    ``plane`` ``(normal, 2)`` are parts of the normals along x and y, ``weights`` ``(normal,
    facet + 1)`` make their colors, ``steepness`` ``(2 normal, facet + 1)`` their derivatives along
    x and then y. ``prior`` is the information of a uniform disk; ``apart`` are the degrees between
    normals that are another answer, else 0.
    """

    def __init__(self, scene: Scene, camera: CameraModel) -> None:
        """Lay out the normals."""
        slope, faces = steepest(scene), scene.indenter.faces
        tilt, azimuth = (part[0, 0] for part in spread_normals(1, 1, NORMALS))
        self.camera, self.plane = camera, plane_parts(slope, tilt, azimuth)
        normals = vectors(self.plane)
        apart = angle(normals[:, None], normals)
        self.weights = color_weights(faces, tilt, azimuth)
        slopes = weight_slopes(faces, tilt, azimuth, slope)
        self.steepness = np.moveaxis(slopes, -1, 0).reshape(-1, faces + 1)
        self._metric = sphere_metric(self.plane)
        self.prior = 4.0 / slope**2  # of a uniform disk
        self._far, self.apart = apart > FAR, np.where(apart > FAR, apart, 0.0)

    def exposed_degrees(self, colors: Array, gain: Array) -> Array:
        """Return the errors, see `ExpectedError`."""
        return _Bound(self, colors, gain).degrees

    def exposed_slopes(self, colors: Array, gain: Array) -> tuple[Array, Array, Array]:
        """Return errors and derivatives, see `ExpectedError`."""
        bound = _Bound(self, colors, gain)
        return bound.degrees, *bound.slopes()


class _Bound:
    """The bound for each of N designs: n normals, c channels; cells are states times sites."""

    def __init__(self, of: PlaceError, colors: Array, gain: Array) -> None:
        self.of, self.shape = of, colors.shape
        self.gain = gain[:, None, None, None]
        colors = colors.reshape(len(colors), -1, *colors.shape[3:])
        counts = of.weights @ colors
        self.dim = (counts > 0.0) & (counts < FULL_SCALE)
        self.counts = np.clip(counts, 0.0, FULL_SCALE)
        floor = of.camera.step**2 / 12.0
        self.variance = np.maximum(of.camera.variance(self.counts, self.gain), floor)
        steep = (of.steepness @ colors).reshape(*counts.shape[:2], 2, *counts.shape[2:])
        self.steep = np.where(self.dim[:, :, None], steep, 0.0)
        known = np.einsum("xginc,xgjnc,xgnc->xgnij", self.steep, self.steep, 1.0 / self.variance,
                          optimize=True)  # fmt: skip
        self.covariance = np.linalg.inv(known + of.prior * np.eye(2))
        trace = np.einsum("xgnij,nji->xgn", self.covariance, of._metric)
        self.near = np.degrees(np.sqrt(np.pi / 4 * trace))
        self.difference = self.counts[:, :, :, None] - self.counts[:, :, None]
        self.both = self.variance[:, :, :, None] + self.variance[:, :, None]
        square = (self.difference**2 / self.both).sum(axis=-1)
        self.alike = np.exp(-square / 2.0)
        self.total = self.alike.sum(axis=-1)
        self.far = (self.alike * of._far).sum(axis=-1) / self.total
        self.confused = (self.alike * of.apart).sum(axis=-1) / self.total

    @property
    def degrees(self) -> Array:
        """Mean over all normals, ``(N,)``."""
        return np.asarray(self.missed.mean(axis=(1, 2)))

    @property
    def missed(self) -> Array:
        """Expected errors ``(N, cell, n)``: near the truth, or as far off as the other answer."""
        return np.asarray((1.0 - self.far) * self.near + self.confused)

    def slopes(self) -> tuple[Array, Array]:
        """Return derivatives by exposed colors and by gain (reverse mode, by hand)."""
        of, count = self.of, self.near[0].size
        turned = self.covariance @ of._metric @ self.covariance
        by_near = (1.0 - self.far) / count
        by_trace = by_near * np.degrees(1.0) ** 2 * np.pi / 8 / self.near
        pulled = np.einsum("xgnij,xgjnc->xginc", turned, self.steep) * by_trace[:, :, None, :, None]
        by_steep = -2.0 * pulled / self.variance[:, :, None]
        by_variance = (pulled * self.steep).sum(axis=2) / self.variance**2
        chosen = np.where(of._far, of.apart, self.near[..., None]) - self.missed[..., None]
        by_alike = chosen / self.total[..., None] / count
        pair = -0.5 * (by_alike + by_alike.swapaxes(2, 3)) * self.alike
        ratio = self.difference / self.both
        by_counts = 2.0 * (pair[..., None] * ratio).sum(axis=3)
        by_variance -= (pair[..., None] * ratio**2).sum(axis=3)
        by_variance = np.where(self.dim, by_variance, 0.0)
        by_counts += by_variance * of.camera.shot * self.gain
        grown = 2.0 * of.camera.read_noise**2 * self.gain + of.camera.shot * self.counts
        by_gain = (by_variance * grown).sum(axis=(1, 2, 3))
        by_counts = np.where(self.dim, by_counts, 0.0)
        by_steep = np.where(self.dim[:, :, None], by_steep, 0.0)
        by_steep = by_steep.reshape(*by_steep.shape[:2], -1, by_steep.shape[-1])
        slopes = of.weights.T @ by_counts + of.steepness.T @ by_steep
        return np.asarray(slopes.reshape(self.shape)), np.asarray(by_gain)
