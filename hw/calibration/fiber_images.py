"""The untouched pad lit by one fiber at a time, drawn by the preview for any material."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hw.calibration.setup import Setup
from render.arrays import Array
from render.preview import compute_response, fiber_end_of, slab_of
from render.preview.glow import Glow
from tactilux import Preview

FEW = 4
"""Directions up to which the random walk serves these alone, with less noise."""
OFFSET_QUANTILES = (0.0, 0.18, 0.36, 0.52, 0.66, 0.78, 0.88, 0.94, 0.98)
"""Twice as many points of light along the edge as the preview has: 2 mm from the edge, nearer than
any site, those of the preview show as a ripple of 3 % that moves with the material."""
WALKED, HEIGHTS = 5, 16
"""Points of light one above the other that the random walk knows, and that draw. With the preview's
three, total reflection by the lower face sets in in steps: a ripple of 4 % on the flat pad, 8 % on
the bent one, 5 to 7 mm from the edge."""


def fiber_images(
    setup: Setup, *, columns: int, rows: int, rays: int, seed: int
) -> NDArray[np.float32]:
    """Return radiance per unit power, ``(bend, fiber, row, column)``, as the camera records it.

    Not cached: calibration asks for very many materials once each, and an emulated rig must not
    share its random numbers with what is fitted to it.

    Arguments:
        setup: with a diffuser, made of what its scene declares.
        columns: of the images.
        rows: of the images.
        rays: light paths of the slab response.
        seed: of these paths.
    """
    scene, phi = setup.scene, setup.phi
    response = compute_response(
        slab_of(scene), fiber_end_of(scene), rays=rays, seed=seed, phi=few_nodes(phi),
        quantiles=OFFSET_QUANTILES, heights=WALKED,
    ).spread_upwards(HEIGHTS)  # fmt: skip
    fibers = scene.fibers.count
    images = np.empty((len(setup.bends), fibers, rows, columns), dtype=np.float32)
    with Preview(scene, lights=Glow(scene, response)) as preview:
        for index, bend in enumerate(setup.bends):
            for first in range(0, fibers, 3):
                # Three fibers per picture, one in each channel.
                own = range(first, min(first + 3, fibers))
                power = np.zeros((fibers, 3))
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
