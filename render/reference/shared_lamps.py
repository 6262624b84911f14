"""Pads whose cells are rendered for all lamps at once (``render.cells.clear_cells``).

Where they are is known before Mitsuba is loaded, so that renders can be planned without it.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from render.geometry import LOWER, counted_sites, flat_fiber_poses
from render.scene import Profile, Scene

STRATA = 4
"""Camera subpaths of a facet in one sample, each from its own part of the facet's pixels."""
MAX_SUBPATHS = 1 << 18
"""Camera subpaths of one pass, as long as every replicate has a sample in it."""
NARROW = np.radians(20.0)
"""Angle from its axis within which a narrow beam has half of its light."""
NEAR = 0.25
"""Distance below the pad, in diameters, under which a lamp lights but a spot of the skin."""


def serves_all_lamps(scene: Scene, bend: float) -> bool:
    """Return whether this pad is one: flat, clear, of smooth or painted faces, lit all over.

    ``bend`` in rad. Where lamps light but a spot of the skin, the others see that spot alone, which
    light subpaths find and camera subpaths do not.
    """
    layer = scene.diffuser
    clear = layer is None or layer.sigma_s + layer.sigma_a == 0.0
    smooth = all(finish.smooth or finish.paint is not None for finish in scene.finishes)
    boundary = scene.pad.index != 1.0 and not scene.window_refracts
    pad = clear and smooth and boundary and scene.coating.lobe is None
    return bend == 0.0 and pad and _lit_all_over(scene)


@lru_cache(maxsize=64)
def _lit_all_over(scene: Scene) -> bool:
    """Return whether all beams are wide, and no lamp is close under the pad or cast into it."""
    poses = flat_fiber_poses(scene)
    if poses.inside.any():
        return False
    near = (poses.face == LOWER) & (poses.gap < NEAR * 2 * poses.radius)
    profiles = dict.fromkeys(lamp.profile for lamp in scene.placed_lamps())
    return not near.any() and all(narrow_share(profile) < 0.5 for profile in profiles)


def narrow_share(profile: Profile) -> float:
    """Return what part of a lamp's light is within `NARROW` of its axis."""
    theta = (np.arange(2000) + 0.5) / 2000 * np.pi / 2
    light = profile.shape(theta) * np.sin(theta)
    return float(light[theta < NARROW].sum() / light.sum())


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
