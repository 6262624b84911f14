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
from render.preview.converged.transport import (
    ConvergedTransport,
    Effort,
    task_count,
    transport_at,
)
from render.preview.diffuser.cache import cache_folder
from render.progress import Clock, OnProgress
from render.scene import Scene

VERSION = 4
"""Part of the cache key: raise it when the paths change."""
PHI_NODES = 13
"""Directions: log transport of `finger20` between them is off by less than 0.1 % (99 %)."""
NODES = chebyshev_nodes(PHI_NODES, 0.0, np.pi)
EFFORT = Effort()
"""What is kept, and looked for."""
AHEAD = np.array([np.pi / 2])
AHEAD_EFFORT = Effort(paths=8192, arrivals=6_000_000, rounds=1)
"""Direction and paths of `transport_ahead`."""


def can_converge(scene: Scene) -> bool:
    """Return whether the compiled paths know the pad: flat, or rolled from flat."""
    return scene.skin is None


def converged_transport(
    scene: Scene,
    progress: OnProgress | None = None,
    *,
    phi: Array = NODES,
    effort: Effort | None = None,
) -> ConvergedTransport:
    """Return transport at nodes and the scene's own bends, which are one more axis.

    ``cells`` ``(lamp, node, bend, site, facet + 1)``, ``grain`` ``(lamp, node, bend)``, ``noise``
    ``(bend,)``; the same bits for any number of threads.

    Arguments:
        scene: the sensor.
        progress: is told of every lamp and facet.
        phi: ``(node,)`` rad, Chebyshev's on [0, pi], or its middle alone.
        effort: how many paths (default: `EFFORT`).
    """
    effort = effort or EFFORT
    bends = scene.bending.angles
    clock = Clock(len(bends) * task_count(scene, effort), progress)
    parts = []
    for bend in bends:
        file = _file(scene, bend, phi, effort)
        kept = read_or_drop(file, *ConvergedTransport._fields)
        if kept is not None:
            clock.skip(task_count(scene, effort))
            parts.append(ConvergedTransport(**kept))
            continue
        parts.append(transport_at(scene, bend, phi, effort, clock))
        try:
            write_npz(file, parts[-1]._asdict())
        except OSError as error:
            warnings.warn(f"converged transport cannot be cached: {error}", stacklevel=2)
    cells, grain = (np.stack([part[i] for part in parts], axis=2) for i in (0, 1))
    return ConvergedTransport(cells, grain, np.stack([part.noise for part in parts]))


def transport_ahead(scene: Scene) -> ConvergedTransport:
    """Return converged transport of few paths at the one node `AHEAD`, for a first answer.

    As `converged_transport`, in a third of the time; kept as well.
    """
    return converged_transport(scene, phi=AHEAD, effort=AHEAD_EFFORT)


def is_kept(scene: Scene) -> bool:
    """Return whether the cache holds converged transport of ``scene`` at all of its bends."""
    return all(_file(scene, bend, NODES, EFFORT).is_file() for bend in scene.bending.angles)


def _file(scene: Scene, bend: float, phi: Array, effort: Effort) -> Path:
    about = f"{VERSION} {scene.hash} {len(phi)} {bend!r} {astuple(effort)}"
    return cache_folder() / f"converged-{hashlib.sha256(about.encode()).hexdigest()[:16]}.npz"
