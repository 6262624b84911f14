"""Expected error of the *sensor* reader in closed form, with its derivatives.

The reader is fitted by ridge regression on noisy colors (`sensor_reader`). In place of draws of
the noise, its expectation to first order in the variance: with features a(x) of a color x of
variance v, the sum of squares that is minimized becomes
``sum |y - W a|^2 + sum_c v_c |W da/dx_c|^2`` (training with noise is Tikhonov regularization,
Bishop 1995). A normal is then missed by the bias ``y - W a`` and by noise of the variances
``v_c |W da/dx_c|^2``; ``sqrt(bias^2 + pi / 4 noise^2)`` is the mean length where either is small
(Rayleigh). Measured against the reader itself: `tests/validation/test_readers.py`.
"""

from __future__ import annotations

import numpy as np

from optimize.design import Array
from optimize.readers.camera_model import FULL_SCALE, CameraModel
from optimize.readers.expected_error import ExpectedError
from optimize.readers.normal_colors import color_weights
from optimize.readers.normals import plane_parts, sphere_metric, spread_normals, steepest
from optimize.readers.polynomials import derivatives, monomials
from optimize.readers.sensor_reader import (
    COLOR_DEGREE,
    LEAST_DEVIATION,
    PLACE_DEGREE,
    RIDGE,
    site_places,
)
from render.scene import Scene

NORMALS = 16
"""Per site and state; 64 raise errors by 1 to 3 % and rank no better (same validation)."""


class SensorError(ExpectedError):
    """The expected error of one scene's designs, in degrees, from their exposed counts.

    ``plane`` ``(state, site, normal, 2)`` are parts of the normals along x and y, ``weights``
    ``(state, site, normal, facet + 1)`` make their colors; ``places`` are monomials of each site.
    """

    def __init__(self, scene: Scene, camera: CameraModel) -> None:
        """Lay out normals and places."""
        places = monomials(site_places(scene), PLACE_DEGREE)
        states, (sites, terms) = len(scene.state_axis), places.shape
        tilt, azimuth = spread_normals(states, sites, NORMALS)
        self.plane = plane = plane_parts(steepest(scene), tilt, azimuth)
        self.camera, self.places = camera, places
        self._pairs = (places[:, :, None] * places[:, None]).reshape(sites, terms**2)
        self.weights = color_weights(scene.indenter.faces, tilt, azimuth)
        # Rows of one site together: (site, state * normal, ...).
        self._plane = np.moveaxis(plane, 0, 1).reshape(sites, -1, 2)
        self._metric = np.moveaxis(sphere_metric(plane), 0, 1).reshape(sites, -1, 2, 2)

    def exposed_degrees(self, colors: Array, gain: Array) -> Array:
        """Return the errors, see `ExpectedError`."""
        return _Fit(self, colors, gain).degrees

    def exposed_slopes(self, colors: Array, gain: Array) -> tuple[Array, Array, Array]:
        """Return errors and derivatives, see `ExpectedError`."""
        fit = _Fit(self, colors, gain)
        return fit.degrees, *fit.slopes()


class _Fit:
    """The reader of each of N designs, kept for the derivatives.

    Shapes: N designs, S sites, R rows (state times normal), C channels, F color monomials,
    P place monomials. ``rows`` ``(N, S, R (1 + C), F)`` are the features and, for each channel,
    their derivatives times the noise's deviation. ``standard`` are colors less their mean, in units
    of ``scale``, as deviations are; ``stretched`` says which channels' scale is that of the colors.
    """

    def __init__(self, of: SensorError, colors: Array, gain: Array) -> None:
        self.of, self.gain = of, gain[:, None, None, None]
        counts = np.moveaxis(of.weights @ colors, 1, 2)
        self.states, self.normals = counts.shape[2:4]
        counts = counts.reshape(*counts.shape[:2], -1, counts.shape[-1])
        self.dim = (counts > 0.0) & (counts < FULL_SCALE)
        self.counts = counts = np.clip(counts, 0.0, FULL_SCALE)
        channels = counts.shape[-1]
        center = counts.mean(axis=(1, 2), keepdims=True)
        scatter = counts.std(axis=(1, 2), keepdims=True)
        self.stretched = scatter > LEAST_DEVIATION
        self.scale = np.maximum(scatter, LEAST_DEVIATION)
        self.deviation = np.sqrt(of.camera.variance(counts, self.gain)) / self.scale
        self.standard = (counts - center) / self.scale
        features = monomials(self.standard, COLOR_DEGREE)
        terms = features.shape[-1]
        lowered = derivatives(channels, COLOR_DEGREE)
        self.slope = np.stack([features @ matrix for matrix in lowered], axis=3)
        noise = self.slope * self.deviation[..., None]
        self.rows = np.concatenate([features[:, :, :, None], noise], axis=3)
        flat = self.rows.reshape(*self.rows.shape[:2], -1, terms)
        gram = flat.swapaxes(2, 3) @ flat
        places = of.places.shape[1]
        gram = of._pairs.T @ gram.reshape(len(colors), -1, terms**2)
        gram = gram.reshape(-1, places, places, terms, terms).swapaxes(2, 3)
        self.gram = gram.reshape(len(colors), places * terms, -1)
        examples = of._plane.shape[0] * of._plane.shape[1]
        self.gram += RIDGE * examples * np.eye(places * terms)
        right = self._spread(features.swapaxes(2, 3) @ of._plane)
        self.weights = self._at_sites(np.linalg.solve(self.gram, right))
        told = (flat @ self.weights).reshape(*self.rows.shape[:4], 2)
        self.told = told
        self.missed = told.copy()
        self.missed[:, :, :, 0] -= of._plane
        # Bias weighs 1, noise pi / 4, on the sphere.
        self.weighed = self.missed @ of._metric
        self.weighed[:, :, :, 1:] *= np.pi / 4
        square = np.einsum("nsrci,nsrci->nsr", self.weighed, self.missed)
        self.length = np.sqrt(np.maximum(square, 1e-18))

    @property
    def degrees(self) -> Array:
        """Mean over all normals, ``(N,)``."""
        return np.asarray(np.degrees(self.length.mean(axis=(1, 2))))

    def slopes(self) -> tuple[Array, Array]:
        """Return derivatives by exposed colors and by gain (reverse mode, by hand)."""
        of, count = self.of, self.length[0].size
        by_told = self.weighed / (count * self.length[..., None, None])
        flat = self.rows.reshape(*self.rows.shape[:2], -1, self.rows.shape[-1])
        pull = by_told.reshape(*flat.shape[:3], 2)
        # Through the weights: they solve gram W = right.
        adjoint = np.linalg.solve(self.gram, self._spread(flat.swapaxes(2, 3) @ pull))
        adjoint = self._at_sites(adjoint)
        turned = (flat @ adjoint).reshape(self.told.shape)
        at_rows = by_told - turned
        at_rows = at_rows.reshape(*flat.shape[:3], 2) @ self.weights.swapaxes(2, 3)
        rest = -self.told
        rest[:, :, :, 0] += of._plane
        at_rows += rest.reshape(*flat.shape[:3], 2) @ adjoint.swapaxes(2, 3)
        at_rows = at_rows.reshape(self.rows.shape)
        by_deviation = np.einsum("nsrcf,nsrcf->nsrc", at_rows[:, :, :, 1:], self.slope)
        by_features = at_rows[:, :, :, 0].copy()
        lowered = derivatives(self.slope.shape[3], COLOR_DEGREE)
        for channel, matrix in enumerate(lowered):
            noise = at_rows[:, :, :, 1 + channel] * self.deviation[..., channel, None]
            by_features += noise @ matrix.T
        by_standard = np.einsum("nsrf,nsrcf->nsrc", by_features, self.slope)
        # Brighter colors move their mean, and by x / n their scale, of colors and deviations alike.
        by_scale = by_standard * self.standard + by_deviation * self.deviation
        by_scale = self.stretched * by_scale.mean(axis=(1, 2), keepdims=True)
        by_counts = by_standard - by_standard.mean(axis=(1, 2), keepdims=True)
        by_counts = (by_counts - by_scale * self.standard) / self.scale
        safe = np.where(self.dim, self.deviation, 1.0)
        by_variance = np.where(self.dim, by_deviation / (2.0 * safe * self.scale**2), 0.0)
        by_counts += by_variance * of.camera.shot * self.gain
        grown = 2.0 * of.camera.read_noise**2 * self.gain + of.camera.shot * self.counts
        by_gain = np.degrees((by_variance * grown).sum(axis=(1, 2, 3)))
        by_counts = np.degrees(np.where(self.dim, by_counts, 0.0))
        shape = (*by_counts.shape[:2], self.states, self.normals, by_counts.shape[-1])
        by_normals = by_counts.reshape(shape).swapaxes(1, 2)
        return np.asarray(of.weights.swapaxes(2, 3) @ by_normals), np.asarray(by_gain)

    def _spread(self, at_sites: Array) -> Array:
        """Return sums over sites ``(N, P F, 2)`` of place monomials times ``(N, S, F, 2)``."""
        designs, sites = at_sites.shape[:2]
        summed = self.of.places.T @ at_sites.reshape(designs, sites, -1)
        return summed.reshape(designs, -1, 2)

    def _at_sites(self, weights: Array) -> Array:
        """Return what ``weights`` ``(N, P F, 2)`` are at each site, ``(N, S, F, 2)``."""
        designs, places = len(weights), self.of.places.shape[1]
        at = self.of.places @ weights.reshape(designs, places, -1)
        return at.reshape(designs, len(self.of.places), -1, 2)
