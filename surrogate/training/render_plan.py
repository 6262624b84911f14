"""The training renders: which cells, how many samples, and where an interrupted run goes on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from render.arrays import Array
from render.chebyshev import chebyshev_nodes
from render.files import read_json, write_json
from render.progress import Progress
from render.reference.cost import render_pace
from render.reference.transport import Estimate, RunPads, render_transport
from render.scene.schema import Scene
from render.transport import TransportTable
from surrogate.model.preview_grid import bend_range

LEAST = 8
"""Samples per cell, however little time there is."""


@dataclass(frozen=True)
class RenderPlan:
    """What is rendered; kept in the run directory, so that a resumed run renders the same.

    Arguments:
        scene_hash: of the scene.
        samples: proposed samples per (fiber, facet) pair and seed.
        seeds: of the independent runs.
        phi, bends: nodes in rad.
    """

    scene_hash: str
    samples: int
    seeds: list[int]
    phi: list[float]
    bends: list[float]


def training_bends(scene: Scene, count: int) -> Array:
    """Return the bends (rad) to render: ``count`` Chebyshev nodes and the scene's own."""
    low, high = bend_range(scene)
    nodes = np.array([high]) if low == high else chebyshev_nodes(count, low, high)
    extra = [a for a in scene.bending.angles if np.abs(nodes - a).min() > 1e-6]
    return np.sort(np.concatenate([nodes, extra]))


def make_plan(
    scene: Scene,
    folder: Path,
    *,
    minutes: float,
    samples: int | None,
    seed: int,
    phi_count: int,
    bend_count: int,
) -> RenderPlan:
    """Return the plan in ``folder``, or a new one; ``samples`` None fills ``minutes``.

    A stored plan is taken up only when it asks for the same scene, nodes, seed and samples.
    """
    phi = chebyshev_nodes(phi_count, 0.0, np.pi).tolist()
    bends = training_bends(scene, bend_count).tolist()
    path = folder / "plan.json"
    stored = _read(path)
    wanted = (scene.hash, [seed + 1], phi, bends)
    if (
        stored is not None
        and (stored.scene_hash, stored.seeds, stored.phi, stored.bends) == wanted
        and samples in (None, stored.samples)
    ):
        return stored
    if samples is None:
        samples = _affordable(scene, np.array(phi), np.array(bends), minutes)
    plan = RenderPlan(scene.hash, samples, [seed + 1], phi, bends)
    write_json(path, asdict(plan))
    return plan


def render_plan(
    scene: Scene,
    plan: RenderPlan,
    folder: Path,
    progress: Callable[[Progress], None] | None,
    runner: RunPads | None = None,
) -> Estimate:
    """Render the cells of ``plan``, going on where ``folder`` stands, or by ``runner``.

    The estimate's ``seconds`` are those of all attempts together.
    """
    return render_transport(
        scene,
        np.array(plan.phi),
        np.array(plan.bends),
        samples=plan.samples,
        seeds=plan.seeds,
        checkpoint=folder / "reference",
        runner=runner,
        progress=progress,
    )


def estimate_table(scene: Scene, plan: RenderPlan, estimate: Estimate) -> TransportTable:
    """Return the estimate as a table, with exposure and lambda still to be fixed."""
    return TransportTable(
        T=estimate.T,
        se=estimate.se,
        phi=np.array(plan.phi),
        exposure=1.0,
        lam=0.0,
        scene_hash=scene.hash,
        level="reference",
        bends=np.array(plan.bends),
        background=estimate.background,
        background_se=estimate.background_se,
    )


def _affordable(scene: Scene, phi: Array, bends: Array, minutes: float) -> int:
    """Return the samples that fill ``minutes``."""
    pace = render_pace(scene, phi)
    left = 60.0 * minutes - pace.spent - pace.fixed * len(bends)
    return max(LEAST, int(left / (pace.each * len(bends))))


def _read(path: Path) -> RenderPlan | None:
    try:
        return RenderPlan(**read_json(path))
    except TypeError:
        return None
