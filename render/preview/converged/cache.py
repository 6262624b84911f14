"""Converged transport of a scene, kept in the user's cache part by part: stopped work goes on."""

from __future__ import annotations

import hashlib
import math
import shutil
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import astuple
from pathlib import Path

import numpy as np

from render.arrays import Array
from render.chebyshev import chebyshev_nodes
from render.files import read_or_drop, write_npz
from render.finished_parts import FinishedParts
from render.geometry import flat_fiber_poses
from render.preview.converged.block import beam_cones
from render.preview.converged.transport import (
    ConvergedTransport,
    Effort,
    flies,
    task_count,
    transport_at,
)
from render.preview.diffuser.cache import cache_folder
from render.progress import Clock, OnProgress
from render.scene import Scene

VERSION = 7
"""Part of the cache key: raise it when the paths change."""
PHI_NODES = 13
"""Directions: log transport of `finger20` between them is off by less than 0.1 % (99 %)."""
SPACING = 1.25
"""Between directions at most, in widths of the narrowest beam (`beam_cones`)."""
MOST_NODES = 129
"""Directions of the narrowest beams, below some 2 deg: their preview errs by more."""
LEAST_BEAM = 1e-4
"""rad that a beam is taken to have at least."""
EFFORT = Effort()
"""What is kept, and looked for."""
FEW_PATHS = Effort(photons=25_000, paths=4096, arrivals=6_000_000, rounds=1)
"""Paths of `few_paths_transport`."""


def phi_nodes(scene: Scene) -> Array:
    """Return directions of the lamps, rad in [0, pi]; the middle one is straight ahead.

    At least `PHI_NODES`, and so many that the narrowest beam that turns passes none by.
    """
    narrowest = narrowest_turning_beam(scene)
    # Chebyshev points are this far apart in the middle, times the number of gaps.
    gaps = np.ceil(0.5 * np.pi**2 / (SPACING * max(narrowest, LEAST_BEAM)))
    count = int(np.clip(gaps + 1, PHI_NODES, MOST_NODES))
    return chebyshev_nodes(count + 1 - count % 2, 0.0, np.pi)


def narrowest_turning_beam(scene: Scene) -> float:
    """Return how wide the narrowest beam of a lamp that turns is, rad; pi where none is narrow.

    Light that leaves a milky layer is wide.
    """
    turning = flies(scene) & flat_fiber_poses(scene).turns
    return float(beam_cones(scene)[turning].min(initial=np.pi))


def converged_transport(
    scene: Scene,
    progress: OnProgress | None = None,
    *,
    effort: Effort | None = None,
) -> ConvergedTransport:
    """Return transport at `phi_nodes` and the scene's own bends or states, which are one more axis.

    ``cells`` ``(lamp, node, bend, site, facet + 1)``, ``grain`` ``(lamp, node, bend)``, ``noise``
    ``(bend,)``; the same bits for any number of threads.

    Arguments:
        scene: the sensor.
        progress: is told of every lamp and facet.
        effort: how many paths (default: `EFFORT`).
    """
    effort = effort or EFFORT
    bends = scene.state_axis
    clock = Clock(len(bends) * task_count(scene, effort), progress)
    return _over_bends([_run(scene, bend, effort, clock) for bend in bends])


def few_paths_transport(scene: Scene, progress: OnProgress | None = None) -> ConvergedTransport:
    """Return what `converged_transport` does, of `FEW_PATHS`: noisier, in a quarter of the time."""
    return converged_transport(scene, progress, effort=FEW_PATHS)


def refinements(
    scene: Scene, goal: float, progress: OnProgress | None = None
) -> Iterator[ConvergedTransport]:
    """Yield transport of less and less photon noise, until it is at most ``goal`` at every bend.

    The first is that of `converged_transport`. For each other, all light paths at the noisiest bend
    were followed once more, with random numbers of their own; it is the mean of all runs. They are
    kept as well, so what was stopped goes on, and the same number of runs has the same bits.

    Arguments:
        scene: the sensor.
        goal: of `ConvergedTransport.noise`, relative, above 0.
        progress: is told of every lamp and facet of a run.
    """
    bends, cost = scene.state_axis, task_count(scene, EFFORT)
    clock = Clock(len(bends) * cost, progress)
    runs = [[_run(scene, bend, EFFORT, clock)] for bend in bends]
    while True:
        means = [_mean_of_runs(each) for each in runs]
        yield _over_bends(means)
        noisiest = max(range(len(bends)), key=lambda bend: float(means[bend].noise))
        if means[noisiest].noise <= goal:
            return
        again, clock = runs[noisiest], Clock(cost, progress)
        again.append(_run(scene, bends[noisiest], EFFORT, clock, seed=len(again)))


def _run(
    scene: Scene, bend: float, effort: Effort, clock: Clock, seed: int = 0
) -> ConvergedTransport:
    """Return transport at one bend, kept or followed now; its parts are kept until it is."""
    file = _file(scene, bend, effort, seed)
    parts = _Parts(file.with_suffix(".parts"), file.stem)
    kept = read_or_drop(file, *ConvergedTransport._fields)
    if kept is not None:
        clock.skip(task_count(scene, effort))
        found = ConvergedTransport(**kept)
    else:
        found = transport_at(scene, bend, phi_nodes(scene), effort, clock, seed, parts)
        with _optional():
            write_npz(file, found._asdict())
    shutil.rmtree(file.with_suffix(".parts"), ignore_errors=True)
    return found


class _Parts(FinishedParts):
    """Parts that are kept where there is room for them."""

    def save(self, name: str, arrays: Mapping[str, Array]) -> None:
        with _optional():
            super().save(name, arrays)


@contextmanager
def _optional() -> Iterator[None]:
    """Warn where the cache takes nothing: light is followed again another time."""
    try:
        yield
    except OSError as error:
        warnings.warn(f"converged transport cannot be cached: {error}", stacklevel=4)


def _over_bends(parts: list[ConvergedTransport]) -> ConvergedTransport:
    cells, grain = (np.stack([part[i] for part in parts], axis=2) for i in (0, 1))
    return ConvergedTransport(cells, grain, np.stack([part.noise for part in parts]))


def _mean_of_runs(runs: list[ConvergedTransport]) -> ConvergedTransport:
    """Return the mean of independent runs at one bend; a photon is worth less."""
    cells, grain = (np.mean([run[i] for run in runs], axis=0) for i in (0, 1))
    noise = math.hypot(*(float(run.noise) for run in runs)) / len(runs)
    return ConvergedTransport(cells, grain / len(runs), np.array(noise))


def is_kept(scene: Scene) -> bool:
    """Return whether the cache holds converged transport of ``scene`` at all of its bends."""
    return all(_file(scene, bend, EFFORT).is_file() for bend in scene.state_axis)


def _file(scene: Scene, bend: float, effort: Effort, seed: int = 0) -> Path:
    about = f"{VERSION} {scene.hash} {len(phi_nodes(scene))} {bend!r} {astuple(effort)}"
    about += f" {seed}" if seed else ""
    return cache_folder() / f"converged-{hashlib.sha256(about.encode()).hexdigest()[:16]}.npz"
