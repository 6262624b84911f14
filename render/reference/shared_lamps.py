"""Pads whose cells are rendered for all lamps at once (``render.cells.clear.clear_cells``).

Where they are is known before Mitsuba is loaded, so that renders can be planned without it.
"""

from __future__ import annotations

import math

from render.geometry import counted_sites
from render.scene import Scene

STRATA = 4
"""Camera subpaths of a facet in one sample, each from its own part of the facet's pixels."""
MAX_SUBPATHS = 1 << 18
"""Camera subpaths of one pass, as long as every replicate has a sample in it."""


def serves_all_lamps(scene: Scene, bend: float) -> bool:
    """Return whether this pad is one: flat, clear, of smooth or painted faces, lamps in the air.

    ``bend`` in rad.
    """
    layer = scene.diffuser
    clear = layer is None or layer.sigma_s + layer.sigma_a == 0.0
    smooth = all(finish.smooth or finish.paint is not None for finish in scene.finishes)
    boundary = scene.pad.index != 1.0
    pad = clear and smooth and boundary and scene.coating.lobe is None
    cast_in = any(lamp.solid for lamp in scene.placed_lamps())
    return bend == 0.0 and pad and not cast_in


def shared_shape(
    scene: Scene, samples: int, replicates: int, per_pass: int | None, *, indented: bool
) -> tuple[int, int]:
    """Return lanes and passes for about ``samples`` camera subpaths of every facet.

    Every replicate has as many lanes as the others; ``per_pass`` as of ``transport_jobs``.
    """
    targets = len(counted_sites(scene)) * (scene.indenter.faces if indented else 1)
    most = max(1, MAX_SUBPATHS // (targets * STRATA * replicates))
    groups = samples / STRATA / replicates
    passes = math.ceil(samples / per_pass if per_pass else groups / most)
    return replicates * max(1, round(groups / passes)), passes
