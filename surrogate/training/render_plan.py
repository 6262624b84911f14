"""The training renders: which cells, how many samples, and where an interrupted run goes on.

They give the reference data: one table, or one per material of a scene that leaves it free.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from render.arrays import Array
from render.chebyshev import chebyshev_nodes
from render.errors import TableError
from render.progress import OnProgress, Progress, in_stage
from render.reference import (
    JobRunner,
    TransportEstimate,
    measure_render_cost,
    render_transport,
    stored_plan,
)
from render.scene import Scene
from render.transport import TransportTable
from surrogate.model.materials import MaterialRange
from surrogate.model.preview_grid import bend_range
from surrogate.training.dataset import TrainingCells, training_cells

MIN_SAMPLES = 8
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
    phi = chebyshev_nodes(phi_count, 0.0, np.pi)
    bends = training_bends(scene, bend_count)
    request: dict[str, Any] = {
        "scene_hash": scene.hash,
        "seeds": [seed + 1],
        "phi": phi.tolist(),
        "bends": bends.tolist(),
    }

    def make() -> RenderPlan:
        chosen = samples
        if chosen is None:
            cost = measure_render_cost(scene, phi)
            chosen = cost.samples_within(60.0 * minutes, [1.0] * len(bends), MIN_SAMPLES)
        return RenderPlan(samples=chosen, **request)

    wanted = request if samples is None else request | {"samples": samples}
    return stored_plan(folder / "plan.json", RenderPlan, wanted, make)


def render_plan(
    scene: Scene,
    plan: RenderPlan,
    folder: Path,
    progress: OnProgress | None,
    runner: JobRunner | None = None,
) -> TransportEstimate:
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


def estimate_table(
    scene: Scene, phi: Array, bends: Array, estimate: TransportEstimate
) -> TransportTable:
    """Return the estimate at nodes ``phi`` and ``bends`` (rad, in its order) as a table.

    Bends ascend in the table; exposure and lambda are still to be fixed.
    """
    order = np.argsort(bends)
    return TransportTable(
        T=estimate.T[:, :, order],
        se=estimate.se[:, :, order],
        phi=phi,
        exposure=1.0,
        lam=0.0,
        scene_hash=scene.hash,
        level="reference",
        bends=bends[order],
        background=estimate.background[:, :, order],
        background_se=estimate.background_se[:, :, order],
    )


@dataclass(frozen=True, eq=False)
class ReferenceData:
    """Reference tables with what is known of their rendering.

    Arguments:
        tables: the scene's own material first.
        renderer: settings, sample counts and seconds.
        materials: ``(material, quantity)`` of the tables, where the scene leaves it free.
    """

    tables: tuple[TransportTable, ...]
    renderer: dict[str, object]
    materials: Array | None = None

    def scaled(self, exposure: float, lam: float) -> ReferenceData:
        """Return the reference with its exposure and lambda."""
        tables = tuple(replace(table, exposure=exposure, lam=lam) for table in self.tables)
        return replace(self, tables=tables)

    def save(self, run: Path) -> None:
        """Write ``reference.npz`` and, for other materials, ``reference-<number>.npz``."""
        self.tables[0].save(run / "reference.npz")
        for number, table in enumerate(self.tables[1:], start=1):
            table.save(run / f"reference-{number}.npz")

    def cells(self, scene: Scene) -> TrainingCells:
        """Return the training cells."""
        return training_cells(scene, self.tables, self.materials)

    @property
    def hash(self) -> str:
        """SHA-256 of the numbers, whatever files they are in."""
        if len(self.tables) == 1:
            return data_hash(self.tables[0])
        every = "".join(data_hash(table) for table in self.tables)
        return hashlib.sha256(every.encode()).hexdigest()


def render_reference(
    scene: Scene,
    run: Path,
    *,
    seed: int,
    minutes: float,
    samples: int | None,
    phi_count: int,
    bend_count: int,
    materials: Array | None,
    progress: OnProgress | None,
) -> ReferenceData:
    """Return the reference of ``scene``, rendered in the folder ``run``, going on where it stands.

    Arguments:
        scene: the sensor.
        run: where plans and renders are kept.
        seed: of the renders; every material has light paths of its own.
        minutes: rendering time of all materials together.
        samples: per cell and material instead.
        phi_count: nodes in phi.
        bend_count: nodes in the bend.
        materials: ``(material, quantity)``; None renders the scene's own alone.
        progress: called as the work goes on.
    """
    free = MaterialRange.of(scene)
    scenes, folders = [scene], [run]
    if free is not None and materials is not None:
        scenes = [free.scene_with(scene, material) for material in materials]
        folders = [run / f"material-{number}" for number in range(len(materials))]
    tables, seconds = [], 0.0
    settings: dict[str, object] = {}
    for number, (variant, folder) in enumerate(zip(scenes, folders, strict=True)):
        if progress:
            progress(Progress(number, len(scenes), stage="plan"))
        plan = make_plan(
            variant,
            folder,
            minutes=minutes / len(scenes),
            samples=samples,
            seed=seed + 100 * number,
            phi_count=phi_count,
            bend_count=bend_count,
        )
        title = "render" if len(scenes) == 1 else f"render material {number + 1} of {len(scenes)}"
        estimate = render_plan(variant, plan, folder, in_stage(progress, title))
        tables.append(estimate_table(variant, np.array(plan.phi), np.array(plan.bends), estimate))
        seconds += float(estimate.seconds)
        settings = settings or dict(estimate.settings)
    return ReferenceData(tuple(tables), settings | {"seconds": seconds}, materials)


def check_reference(scene: Scene, table: TransportTable) -> None:
    """Refuse a table that is no reference of ``scene``.

    Raises:
        TableError: it is of another scene or level.
    """
    if table.scene_hash != scene.hash or table.level != "reference":
        raise TableError(
            f"the table is of level {table.level!r} and scene {table.scene_hash or 'unknown'}, "
            f"allowed: level 'reference' of scene {scene.hash}: leave --table out to render one",
            field="table",
        )


def data_hash(table: TransportTable) -> str:
    """Return the SHA-256 of the numbers in ``table``, whatever file they are in."""
    digest = hashlib.sha256(table.scene_hash.encode())
    for values in (table.phi, table.bends, table.T, table.se, table.background):
        if values is not None:
            digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
    return digest.hexdigest()
