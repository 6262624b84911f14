"""Converged transport of a scene, kept in the user's cache bend by bend: stopped work goes on."""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import astuple
from pathlib import Path

import numpy as np

from render.arrays import Array
from render.chebyshev import chebyshev_nodes
from render.files import read_or_drop, write_npz
from render.geometry import flat_fiber_poses
from render.preview.converged.transport import Effort, task_count, transport_at
from render.preview.diffuser.cache import cache_folder, slab_of
from render.preview.diffuser.response import OPAQUE_THICKNESS
from render.progress import Clock, OnProgress
from render.scene import Scene

VERSION = 1
"""Part of the cache key: raise it when the paths change."""
PHI_NODES = 13
"""Directions: log transport of `finger20` between them is off by less than 0.1 % (99 %)."""
NODES = chebyshev_nodes(PHI_NODES, 0.0, np.pi)


def limitation(scene: Scene) -> str:
    """Return why converged transport does not serve ``scene``, as a clause; empty where it does.

    All light has to come out of the diffuser, and scattered: light that passes it straight, or
    enters the pad beside it, is too narrow for the few terms of the exit field.
    """
    if scene.diffuser is None:
        return "it has no diffuser"
    if (flat_fiber_poses(scene).layer <= 0.0).any():
        return "not all of its lamps shine through the diffuser"
    if len(set(scene.finishes)) > 1:
        return "its faces are not all alike"
    thickness = slab_of(scene).optical_thickness
    if thickness < OPAQUE_THICKNESS:
        return (
            f"its diffuser has an optical thickness of {thickness:.2g}, and up to "
            f"{OPAQUE_THICKNESS:g} light passes straight"
        )
    return ""


def converged_transport(
    scene: Scene, progress: OnProgress | None = None, effort: Effort | None = None
) -> Array:
    """Return transport ``(lamp, node, bend, site, facet + 1)``, the last the untouched pad.

    Radiance at the camera in 1/(mm^2 sr) per unit power, at `NODES` and the scene's own bends.
    Cells hold the noise of the paths, at most some 1 % with the default effort; the same bits for
    any number of threads.

    Arguments:
        scene: a sensor without a `limitation`.
        progress: is told of every lamp and facet.
        effort: how many paths.
    """
    effort = effort or Effort()
    bends = scene.bending.angles
    clock = Clock(len(bends) * task_count(scene), progress)
    parts = []
    for bend in bends:
        kept = read_or_drop(_file(scene, bend, effort), "transport")
        if kept is not None:
            clock.skip(task_count(scene))
            parts.append(kept["transport"])
            continue
        parts.append(transport_at(scene, bend, NODES, effort, clock))
        try:
            write_npz(_file(scene, bend, effort), {"transport": parts[-1]})
        except OSError as error:
            warnings.warn(f"converged transport cannot be cached: {error}", stacklevel=2)
    return np.stack(parts, axis=2)


def is_kept(scene: Scene) -> bool:
    """Return whether the cache holds converged transport of ``scene`` at all of its bends."""
    return all(_file(scene, bend, Effort()).is_file() for bend in scene.bending.angles)


def _file(scene: Scene, bend: float, effort: Effort) -> Path:
    about = f"{VERSION} {scene.hash} {PHI_NODES} {bend!r} {astuple(effort)}"
    return cache_folder() / f"converged-{hashlib.sha256(about.encode()).hexdigest()[:16]}.npz"
