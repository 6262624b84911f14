"""A skin that is not flat as the shader reads it: textures of heights, normals and frames of sites.

Heights are sampled from the chart, so the shader knows no shape.
"""

from __future__ import annotations

import numpy as np

from render.arrays import Array
from render.geometry import HeightMap, Imprint, SkinChart
from render.scene import EDGES, OUTWARD, Scene

SKIN_STEPS, EDGE_STEPS = 257, 513
"""Samples along the pad's sides, of the skin and of its height at the edges."""


def skin_texels(scene: Scene, imprint: Imprint | HeightMap) -> dict[str, Array]:
    """Return the textures ``(row, column, component)`` of a curved skin by their uniforms' names.

    ``skin``: normal into the pad and height, rows along y. ``edge_height``: a row for each of
    `EDGES`, columns towards +x or +y. ``site_frames``: a row for each body that is pressed in:
    position, across, towards the tip, out of the pad.
    """
    chart = SkinChart(scene, 0.0)
    half = np.array([scene.pad.width, scene.pad.length]) / 2
    edges = []
    for outward in OUTWARD[: len(EDGES), :2]:
        along = np.linspace(-1.0, 1.0, EDGE_STEPS)[:, None] * np.abs(outward[::-1]) * half
        edges.append(chart.height(along + outward * half))
    texels = {"skin": skin_surface(scene, SKIN_STEPS), "edge_height": np.stack(edges)[..., None]}
    if isinstance(imprint, Imprint):
        frames = np.swapaxes(imprint.turn, -1, -2)
        texels["site_frames"] = np.concatenate([imprint.center[:, None], frames], axis=1)
    return texels


def skin_surface(scene: Scene, steps: int) -> Array:
    """Return normals into the pad and heights (mm) ``(steps, steps, 4)``, rows along y.

    On an even grid over the pad, its border included.
    """
    x, y = (np.linspace(-side / 2, side / 2, steps) for side in (scene.pad.width, scene.pad.length))
    uv, chart = np.stack(np.meshgrid(x, y), axis=-1), SkinChart(scene, 0.0)
    return np.concatenate([-chart.frames(uv)[..., 2], chart.height(uv)[..., None]], axis=-1)
