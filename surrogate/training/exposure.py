"""Exposure and lambda: fixed once per scene, from the reference's image of the baseline design."""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.chebyshev import interpolation_weights
from render.errors import TableError
from render.geometry import fiber_edges
from render.metric import choose_exposure, choose_lambda, image_counts
from render.scene import COLORS, Scene
from render.transport import TransportTable


def baseline_power(scene: Scene) -> Array:
    """Return the power ``(fiber, 3)`` of the baseline design: one color per edge (thesis 5.1)."""
    index = [COLORS.index(getattr(scene.baseline, edge)) for edge in fiber_edges(scene)]
    return np.asarray(np.eye(3)[index])


def exposure_and_lambda(scene: Scene, table: TransportTable) -> tuple[float, float]:
    """Return ``(exposure, lam)`` of the baseline design (phi = pi/2) at the scene's bends.

    Raises:
        TableError: the table does not span the scene's bends, or its baseline is dark.
    """
    angles = np.array(scene.bending.angles)
    if angles.min() < table.bends.min() - 1e-9 or angles.max() > table.bends.max() + 1e-9:
        raise TableError(
            f"the reference table spans bends {np.degrees(table.bends.min()):g} to "
            f"{np.degrees(table.bends.max()):g} deg, allowed: the scene's "
            f"{np.degrees(angles.min()):g} to {np.degrees(angles.max()):g} deg",
            field="bends",
        )
    light = table.at(np.full(scene.fibers.count, np.pi / 2))
    light = np.einsum("ab,fbsk->fask", interpolation_weights(table.bends, angles), light)
    power = baseline_power(scene)
    radiance = np.einsum("fbsk,fc->bskc", light, power)
    exposure = choose_exposure(radiance, int(angles.argmin()))
    return exposure, choose_lambda(np.asarray(image_counts(light, power, exposure)))
