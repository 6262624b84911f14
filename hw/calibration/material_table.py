"""What the reference lines show for any material: drawn for some materials, smooth in between.

The preview is physical in the material (its slab response is a random walk in it) but takes
seconds per material, far too long for a fit. So it is run for materials that fill the range
evenly (Sobol), each with random numbers of its own, and a polynomial of the second degree in the
material is fitted to the logarithm of the light at every point; the regression averages the
random walks' noise. Leaving each material out in turn gives the error of all this.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hw.calibration.material import MaterialSpace
from hw.calibration.reference_lines import Setup, sample_image
from render.arrays import Array
from render.files import read_or_drop, write_npz
from render.preview import compute_response, fiber_end_of, slab_of
from render.preview.glow import Glow
from render.progress import Clock, OnProgress
from tactilux import Preview, Scene

VERSION = 5
RAYS = 100_000
"""Light paths of each material's slab response."""
ROWS = 200
"""Height of the drawn images."""
FEW = 4
"""Directions up to which the random walk serves these alone, with less noise."""
OFFSET_QUANTILES = (0.0, 0.18, 0.36, 0.52, 0.66, 0.78, 0.88, 0.94, 0.98)
"""Twice as many points of light along the edge as the preview has: 2 mm from the edge, nearer than
any site, those of the preview show as a ripple of 3 % that moves with the material."""
WALKED, HEIGHTS = 5, 16
"""Points of light one above the other that the random walk knows, and that draw. With the preview's
three, total reflection by the lower face sets in in steps: a ripple of 4 % on the flat pad, 8 % on
the bent one, 5 to 7 mm from the edge."""


def drawn_size(scene: Scene) -> tuple[int, int]:
    """Return rows and columns of drawn images: fewer than the camera's, in its proportion."""
    return ROWS, round(ROWS * scene.camera.columns / scene.camera.rows)


def fiber_images(setup: Setup, *, rays: int, seed: int) -> NDArray[np.float32]:
    """Return radiance per unit power, ``(bend, fiber, row, column)``, as the camera records it.

    The skin has one albedo.

    Rows and columns are `drawn_size`. Not cached: calibration asks for very many materials once
    each, and an emulated rig must not share its random numbers with what is fitted to it.

    The slab response takes ``rays`` light paths of their own ``seed``; without a diffuser there is
    none.
    """
    scene, phi = setup.scene, setup.phi
    assert not scene.by_channel
    fibers, glow = scene.lamp_count, None
    rows, columns = drawn_size(scene)
    channels = len(scene.palette.channels)
    images = np.empty((len(setup.bends), fibers, rows, columns), dtype=np.float32)
    if scene.diffuser is not None:
        response = compute_response(
            slab_of(scene), fiber_end_of(scene), rays=rays, seed=seed, phi=few_nodes(phi),
            quantiles=OFFSET_QUANTILES, heights=WALKED,
        ).spread_upwards(HEIGHTS)  # fmt: skip
        glow = Glow(scene, [response] * fibers, np.arange(fibers))
    with Preview(scene, lights=glow) as preview:
        for index, bend in enumerate(setup.bends):
            for first in range(0, fibers, channels):
                # As many fibers per picture as there are channels, one in each.
                own = range(first, min(first + channels, fibers))
                power = np.zeros((fibers, channels))
                power[own, np.arange(len(own))] = 1.0
                drawn = preview.picture(phi, power, float(bend), columns, rows, indented=False)
                # The preview draws as seen from the coating's side; the camera sees the mirror
                # image.
                images[index, own] = np.moveaxis(drawn[:, ::-1], -1, 0)[: len(own)]
    return images


def few_nodes(phi: Array) -> Array | None:
    """Return nodes that hold all of ``phi`` and their mirror images, None if these are many."""
    nodes = np.unique(np.round(np.concatenate([phi, np.pi - phi]), 9))
    # Mirror images again, so that rounding leaves them exact.
    nodes = 0.5 * (nodes + (np.pi - nodes[::-1]))
    return nodes if len(nodes) <= FEW else None


@dataclass(frozen=True, eq=False)
class MaterialTable:
    """Log light at the reference lines as a polynomial in the material.

    Arguments:
        space: of the materials.
        coefficients: ``(term, bend, fiber, point)`` of log light less the log of the albedo, where
            it is fitted: light grows with it faster than a polynomial of its logarithm follows.
            NaN where the camera sees nothing.
        left_out: ``(material, bend, fiber, point)`` errors of log light at materials left out.
    """

    space: MaterialSpace
    coefficients: Array
    left_out: Array

    def log_light(self, material: Array) -> Array:
        """Return log radiance per unit power, ``(bend, fiber, point)``, for one material."""
        polynomial = np.tensordot(self.space.terms(material), self.coefficients, axes=1)
        return np.asarray(polynomial + self.space.log_factor(material))

    def scatter(self) -> Array:
        """Return the rms error ``(bend,)`` of the shape of log light at a material left out."""
        shape = self.left_out - np.nanmean(self.left_out, axis=-1, keepdims=True)
        return np.asarray(np.sqrt(np.nanmean(shape**2, axis=(0, 2, 3))))


def material_table(
    setup: Setup, *, folder: Path, progress: OnProgress | None = None
) -> MaterialTable:
    """Return the table; interrupted work goes on where it stood.

    The ``setup``'s own material does not matter; the light of each is kept in ``folder``.
    """
    count = setup.space.enough
    materials = setup.space.sobol(count)
    parts = folder / f"materials-{setup.key(VERSION, count, RAYS)}"
    pixels = setup.line_pixels(*drawn_size(setup.scene))
    drawn, clock = [], Clock(count, progress)
    for number, material in enumerate(materials):
        path = parts / f"{number:03d}.npz"
        kept = read_or_drop(path, "log_light")
        if kept is None:
            light = line_light(setup.of(material), pixels=pixels, rays=RAYS, seed=1000 + number)
            with np.errstate(divide="ignore"):
                kept = {"log_light": np.where(light > 0, np.log(light), np.nan)}
            write_npz(path, kept)
        drawn.append(kept["log_light"])
        clock.tick()
    return fitted_table(setup.space, materials, np.stack(drawn))


def line_light(setup: Setup, *, pixels: Array, rays: int, seed: int) -> Array:
    """Return radiance per unit power at the reference lines, ``(bend, fiber, point)``.

    Drawn by the preview for the scene's own material; NaN where the camera sees nothing.
    """
    images = fiber_images(setup, rays=rays, seed=seed)
    flat = zip(
        images.reshape(-1, *images.shape[2:]), pixels.reshape(-1, *pixels.shape[2:]), strict=True
    )
    return np.stack([sample_image(*pair) for pair in flat]).reshape(pixels.shape[:-1])


def fitted_table(space: MaterialSpace, materials: Array, log_light: Array) -> MaterialTable:
    """Return the least-squares polynomial and its leave-one-out errors.

    ``materials`` of ``space`` are ``(material, quantity)``; ``log_light`` is ``(material, bend,
    fiber, point)``, NaN where the camera sees nothing.
    """
    basis = space.terms(materials)
    log_light = log_light - space.log_factor(materials)[:, None, None, None]
    seen = np.isfinite(log_light).all(axis=0)
    values = np.where(seen, log_light, 0.0).reshape(len(log_light), -1)
    inverse = np.linalg.pinv(basis)
    coefficients = inverse @ values
    # The residual of a material left out is the plain one over 1 - leverage.
    leverage = np.einsum("mt,tm->m", basis, inverse)
    left_out = (values - basis @ coefficients) / (1 - leverage)[:, None]
    hidden: Array = np.where(seen, 0.0, np.nan)
    tables = (whole.reshape(-1, *seen.shape) + hidden for whole in (coefficients, left_out))
    return MaterialTable(space, *tables)
