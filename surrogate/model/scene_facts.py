"""What a model says of its scene, and of the preview grid that it stands on."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from render.geometry import counted_sites
from render.metric import THESIS
from render.scene import Scene
from surrogate.model.preview_grid import PreviewGrid
from surrogate.runtime.metadata import axes_of


def scene_facts(scene: Scene, grid: PreviewGrid) -> dict[str, Any]:
    """Return those fields of `ModelMetadata` that follow from scene and grid alone.

    ``sites`` are those that count, as in the grid and in every table; angles in rad.
    """
    return {
        "scene": scene.name,
        "scene_hash": scene.hash,
        "fibers": scene.lamp_count,
        "sites": len(counted_sites(scene)),
        "facets": scene.indenter.faces,
        "scene_bends": list(scene.state_axis),
        "axes": axes_of(scene.palette.channels),
        "by_channel": scene.by_channel,
        "states": [] if scene.states is None else list(scene.state_names),
        "bounds": {
            "phi": [0.0, math.pi],
            "power": [0.0, 1.0],
            "bend": [float(grid.bends.min()), float(grid.bends.max())],
        },
        "conventions": asdict(THESIS),
    }


def grid_facts(grid: PreviewGrid) -> dict[str, Any]:
    """Return the sizes of the grid, how many of its cells are darker than its floor, its noise."""
    facts: dict[str, Any] = {
        "phi_nodes": len(grid.phi),
        "bend_nodes": len(grid.bends),
        "floored": grid.floored,
    }
    if grid.photon_noise is not None:
        facts["photon_noise"] = grid.photon_noise
    return facts
