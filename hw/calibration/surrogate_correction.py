"""What the surrogate knows better than the preview, carried from the sites to the whole pad.

The preview draws whole photographs for any material, but is too dim for grazing light on a bent
pad; the surrogate was fitted to renders, but knows the sites of one material only. The ratio of
both on the untouched pad, for the surrogate's own material, is a smooth field: its logarithm is
taken as a polynomial of the second degree over the pad, and as independent of the material.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.geometry.layout import flat_sites
from render.preview.preview import Preview
from render.scene.schema import Scene
from surrogate.runtime.checker import Checker


@dataclass(frozen=True, eq=False)
class SurrogateCorrection:
    """Log of light of the surrogate over that of the preview.

    Arguments:
        coefficients: ``(bend, fiber, term)``.
        reach: ``(2, 2)`` lowest and highest flat x, y (mm) of the sites; beyond, the edge's value
            holds.
        left: ``(bend,)`` rms of log ratios at the sites that the polynomial leaves.
    """

    coefficients: Array
    reach: Array
    left: Array

    def log_ratio(self, bend: int, fiber: int, position: Array) -> Array:
        """Return log ratios ``(...)`` at flat positions ``(..., 2)`` mm of one bend and fiber."""
        inside = np.clip(np.nan_to_num(position), *self.reach)
        return np.asarray(_terms(inside) @ self.coefficients[bend, fiber])


def surrogate_correction(
    scene: Scene, checker: Checker, phi: Array, bends: Array
) -> SurrogateCorrection:
    """Return the correction for directions ``phi`` ``(fiber,)`` and ``bends`` ``(bend,)``, rad.

    Arguments:
        scene: the surrogate's own, with the material that it was trained for.
        checker: its model.
        phi: ``(fiber,)`` rad.
        bends: ``(bend,)`` rad.
    """
    # All fibers at all directions: the diagonal is what is wanted.
    nodes = np.unique(phi)
    table = checker.transport_table(nodes, bends)
    assert table.background is not None
    own = table.background[np.arange(len(phi)), np.searchsorted(nodes, phi)]
    with Preview(scene) as preview:
        drawn = preview.transport(phi[:, None], bends)[1][:, 0]
    ratio = np.log(own / drawn).swapaxes(0, 1)
    sites = flat_sites(scene)[:, :2]
    terms = _terms(sites)
    coefficients = ratio @ np.linalg.pinv(terms).T
    left = ratio - coefficients @ terms.T
    reach = np.stack([sites.min(axis=0), sites.max(axis=0)])
    return SurrogateCorrection(coefficients, reach, np.sqrt((left**2).mean(axis=(1, 2))))


def _terms(position: Array) -> Array:
    x, y = position[..., 0] / 10.0, position[..., 1] / 10.0
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
