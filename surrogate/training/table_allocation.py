"""Where the samples of a scene's own table go: to the cells that move the scores of its designs.

Where lamps cannot turn, a design is a choice of colors and the table is the whole model. Its cells
do not matter alike: derivatives of S by their light are known exactly on the preview. They are
taken of random colors, which is what intervals are measured on, and of the best of them once more,
which is what a search will look at. The preview has no noise of renders, and is only asked where to
look: where it is wrong, samples are spent less well (`render.reference.allocation`).
"""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.choose_exposure import ScoreScale
from render.geometry import is_mirror_symmetric, mirror_image
from render.metric import THESIS
from render.metric_gradient import score_by_counts
from render.scene import Scene
from surrogate.model.lamp_copies import split_power
from surrogate.model.preview_grid import PreviewGrid

COLORINGS, BEST = 200, 20
"""Random colors of the lamps that are scored, and how many of them lead."""


def table_shares(
    scene: Scene, grid: PreviewGrid, phi: Array, bends: Array, scale: ScoreScale
) -> Array:
    """Return shares ``(bend, site, lamp)`` of the samples of a table at one direction node.

    Arguments:
        scene: the sensor; its lamps cannot turn.
        grid: its preview.
        phi: the node, ``(1,)`` rad.
        bends: ``(bend,)`` rad.
        scale: exposure and lambda.
    """
    light = scale.exposure * np.exp(grid.evaluate(phi, bends))[:, 0, ..., :-1]
    lamps, (rng, palette) = scene.lamp_count, (np.random.default_rng(0), scene.palette.matrix)
    chosen = palette[rng.integers(0, len(palette), (COLORINGS, lamps))]
    scores, squares = np.empty(COLORINGS), np.empty((COLORINGS, lamps, *light.shape[1:]))
    symmetric = is_mirror_symmetric(scene, np.tile(phi, (lamps, 1)))
    for index, power in enumerate(split_power(scene, chosen)):
        counts = np.einsum("fbsk,fc->bskc", light, power)
        scores[index], by_counts = score_by_counts(counts, scale.lam, THESIS)
        change = light * np.einsum("bskc,fc->fbsk", by_counts, power)
        # All copies of a lamp are rendered from the same random numbers: their noise adds up.
        change = change.reshape(-1, lamps, *change.shape[1:]).sum(axis=0)
        if symmetric:
            # Renders of a symmetric sensor are the mean of what they found and its mirror image.
            change = 0.5 * (change + mirror_image(scene, change[:, None], facets=True)[:, 0])
        squares[index] = change**2
    leading = np.argsort(-scores)[:BEST]
    both = squares.mean(axis=0) + squares[leading].mean(axis=0)
    # (lamp, bend, site, facet) -> (bend, site, lamp)
    return np.asarray(np.sqrt(both.sum(axis=-1)).transpose(1, 2, 0))
