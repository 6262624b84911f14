"""The training renders: which cells, how many samples, and where an interrupted run goes on.

They give the reference data: one table, or one per material of a scene that leaves it free.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from render.arrays import Array
from render.chebyshev import chebyshev_nodes
from render.errors import TableError
from render.files import read_json, read_or_drop
from render.progress import OnProgress, in_stage
from render.reference import (
    SampleAllocation,
    TimeBudget,
    TransportEstimate,
    render_transport,
    render_within,
    samples_per_pass,
    stored_plan,
    transport_jobs,
)
from render.scene import Scene
from render.transport import TransportTable
from surrogate.model.materials import MaterialRange
from surrogate.model.preview_grid import bend_range, direction_nodes

if TYPE_CHECKING:  # torch comes with the cells
    from surrogate.training.dataset import TrainingCells

PLAN, LONGER_PLAN, RENDERS = "plan.json", "longer.json", "reference"
"""The plan, the one that a fit without networks left time for, and the folder of the renders in the
folder of a run."""
MATERIAL_SEED = 100
"""Difference of the seeds of one material and the next."""


@dataclass(frozen=True)
class RenderPlan:
    """What is rendered; kept in the run directory, so that a resumed run renders the same.

    Arguments:
        scene_hashes: of the scene, or of its variants of different materials.
        samples: proposed samples per (fiber, facet) pair and seed.
        per_pass: of ``transport_jobs``; None where the samples were given.
        minutes: that the samples were chosen for; 0 where they were given.
        seeds: of the scenes, each with light paths of its own.
        phi, bends: nodes in rad.
        shares: ``(bend, site, lamp)`` of the samples (``SampleAllocation``); None for the usual.
    """

    scene_hashes: list[str]
    samples: int
    per_pass: int | None
    minutes: float
    seeds: list[int]
    phi: list[float]
    bends: list[float]
    shares: list[list[list[float]]] | None = None

    @property
    def allocation(self) -> SampleAllocation:
        """Where the samples go."""
        return SampleAllocation(None if self.shares is None else np.array(self.shares))


@dataclass(frozen=True)
class RenderTime:
    """The time of renders that something else follows.

    Arguments:
        budget: of everything.
        reserve: returns the seconds that the rest needs (`render_within`).
    """

    budget: TimeBudget
    reserve: Callable[[], float]


def training_bends(scene: Scene, count: int) -> Array:
    """Return the bends (rad) to render: ``count`` Chebyshev nodes and the scene's own.

    Of a scene with named states, their numbers.
    """
    if scene.states is not None:
        return np.array(scene.state_axis)
    low, high = bend_range(scene)
    nodes = np.array([high]) if low == high else chebyshev_nodes(count, low, high)
    extra = [a for a in scene.bending.angles if np.abs(nodes - a).min() > 1e-6]
    return np.sort(np.concatenate([nodes, extra]))


def make_plan(
    scenes: Sequence[Scene],
    run: Path,
    *,
    seed: int,
    phi: Array,
    bends: Array,
    samples: int | None,
    per_pass: int | None = None,
    within: RenderTime | None = None,
    shares: Array | None = None,
    progress: OnProgress | None = None,
) -> RenderPlan:
    """Return the plan in the folder ``run``, or a new one.

    ``per_pass`` is that of ``transport_jobs`` where ``samples`` are given. A stored plan is taken
    up only when it asks for the same scenes, nodes, seed, and samples or minutes. Where there are
    only minutes, all that fits into them is rendered by the way, by ``shares``.
    """
    if samples is None and within is None:
        raise ValueError("a plan needs samples or a time")
    request: dict[str, Any] = {
        "scene_hashes": [scene.hash for scene in scenes],
        "seeds": [seed + 1 + MATERIAL_SEED * number for number in range(len(scenes))],
        "phi": phi.tolist(),
        "bends": bends.tolist(),
    }
    if samples is not None:
        request |= {"samples": samples, "per_pass": per_pass, "minutes": 0.0}
        return stored_plan(run / PLAN, RenderPlan, request, lambda: RenderPlan(**request))
    assert within is not None
    request |= {"minutes": within.budget.seconds / 60.0}

    def make() -> RenderPlan:
        count = 2 * len(bends) * sum(len(scene.albedos) for scene in scenes)
        each = samples_per_pass(scenes[0], within.budget.left() - within.reserve(), count)
        told = None if shares is None else shares.tolist()
        plan = RenderPlan(samples=each, per_pass=each, shares=told, **request)
        return _filled(scenes, run, plan, within, progress)

    return stored_plan(run / PLAN, RenderPlan, request, make)


def longer_plan(
    scenes: Sequence[Scene],
    run: Path,
    plan: RenderPlan,
    within: RenderTime,
    progress: OnProgress | None,
) -> RenderPlan | None:
    """Return ``plan`` with as many more passes as the time ``within`` has, None for not even one.

    Those are rendered by the way; kept like the first plan, so that it is the same again.
    """
    known = read_json(run / LONGER_PLAN)
    request = {key: value for key, value in asdict(plan).items() if key != "samples"}
    if plan.per_pass is None:
        return None
    if any(known.get(key) != value for key, value in request.items()):
        one = rendered_seconds(run) * plan.per_pass / plan.samples
        if within.budget.left() - within.reserve() < one:
            return None
    each = replace(plan, samples=plan.per_pass)
    return stored_plan(
        run / LONGER_PLAN,
        RenderPlan,
        request,
        lambda: _filled(scenes, run, each, within, progress),
    )


def rendered_seconds(run: Path) -> float:
    """Return the seconds that the renders in the folder ``run`` took, of all attempts together."""
    states = [read_or_drop(path) for path in (run / RENDERS).glob("*.passes.npz")]
    return sum(float(state["seconds"]) for state in states if state is not None)


def _filled(
    scenes: Sequence[Scene],
    run: Path,
    plan: RenderPlan,
    within: RenderTime,
    progress: OnProgress | None,
) -> RenderPlan:
    """Return ``plan``, of one pass, with as many passes as fit into the time: they are rendered."""
    phi, bends = np.array(plan.phi), np.array(plan.bends)
    jobs = [
        job
        for scene, number in zip(scenes, plan.seeds, strict=True)
        for job in transport_jobs(
            scene,
            phi,
            bends,
            samples=plan.samples,
            per_pass=plan.per_pass,
            seeds=[number],
            allocation=plan.allocation,
        )
    ]
    units = render_within(
        jobs, within.budget, run / RENDERS, reserve=within.reserve, progress=progress
    )
    return replace(plan, samples=units * plan.samples)


def render_plan(
    scene: Scene, plan: RenderPlan, run: Path, number: int, progress: OnProgress | None
) -> TransportEstimate:
    """Render the cells of the plan's scene ``number``, going on where the folder ``run`` stands.

    The estimate's ``seconds`` are those of all attempts together.
    """
    return render_transport(
        scene,
        np.array(plan.phi),
        np.array(plan.bends),
        samples=plan.samples,
        per_pass=plan.per_pass,
        seeds=[plan.seeds[number]],
        allocation=plan.allocation,
        checkpoint=run / RENDERS,
        progress=progress,
    )


def estimate_table(
    scene: Scene, phi: Array, bends: Array, estimate: TransportEstimate
) -> TransportTable:
    """Return the estimate at nodes ``phi`` and ``bends`` (rad, in its order) as a table.

    Bends ascend in the table; exposure and lambda are still to be fixed.
    """
    order = np.argsort(bends)
    pad = np.expand_dims(estimate.background_replicates, 5)
    replicates = np.concatenate([estimate.replicates, pad], axis=5)
    halves = [replicates[start::2].mean(axis=0)[:, :, order] for start in (0, 1)]
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
        half_difference=0.5 * (halves[0] - halves[1]),
    )


@dataclass(frozen=True, eq=False)
class ReferenceData:
    """Reference tables with what is known of their rendering.

    Arguments:
        tables: the scene's own material first.
        renderer: settings and sample counts; seconds: that the renders took.
        materials: ``(material, quantity)`` of the tables, where the scene leaves it free.
        plan: by which they were rendered; None for a table that was given.
    """

    tables: tuple[TransportTable, ...]
    renderer: dict[str, object]
    seconds: float = 0.0
    materials: Array | None = None
    plan: RenderPlan | None = None

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
        from surrogate.training.dataset import training_cells

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
    samples: int | None,
    phi_count: int,
    bend_count: int,
    materials: Array | None = None,
    per_pass: int | None = None,
    within: RenderTime | None = None,
    shares: Array | None = None,
    progress: OnProgress | None = None,
) -> ReferenceData:
    """Return the reference of ``scene``, rendered in the folder ``run``, going on where it stands.

    Every one of ``materials`` ``(material, quantity)`` has light paths of its own; None renders the
    scene's own alone. ``samples`` are per cell and material, in passes of ``per_pass``
    (``transport_jobs``); None renders as many as the time ``within`` allows, by ``shares``
    (`surrogate.training.table_allocation`).
    """
    scenes = _variants(scene, materials)
    plan = make_plan(
        scenes,
        run,
        seed=seed,
        phi=direction_nodes(scene, phi_count),
        bends=training_bends(scene, bend_count),
        samples=samples,
        per_pass=per_pass,
        within=within,
        shares=shares,
        progress=in_stage(progress, "render"),
    )
    return _rendered(scenes, run, plan, materials, progress)


def render_longer(
    scene: Scene,
    run: Path,
    reference: ReferenceData,
    within: RenderTime,
    progress: OnProgress | None,
) -> ReferenceData | None:
    """Return ``reference`` with the passes that the time ``within`` has left; None for none."""
    if reference.plan is None:
        return None
    scenes = _variants(scene, reference.materials)
    told = in_stage(progress, "render")
    plan = longer_plan(scenes, run, reference.plan, within, told)
    if plan is None:
        return None
    return _rendered(scenes, run, plan, reference.materials, progress)


def _variants(scene: Scene, materials: Array | None) -> list[Scene]:
    free = MaterialRange.of(scene)
    if free is None or materials is None:
        return [scene]
    return [free.scene_with(scene, material) for material in materials]


def _rendered(
    scenes: Sequence[Scene],
    run: Path,
    plan: RenderPlan,
    materials: Array | None,
    progress: OnProgress | None,
) -> ReferenceData:
    tables, seconds = [], 0.0
    settings: dict[str, object] = {}
    for number, variant in enumerate(scenes):
        title = "render" if len(scenes) == 1 else f"render material {number + 1} of {len(scenes)}"
        estimate = render_plan(variant, plan, run, number, in_stage(progress, title))
        tables.append(estimate_table(variant, np.array(plan.phi), np.array(plan.bends), estimate))
        seconds += float(estimate.seconds)
        settings = settings or dict(estimate.settings)
    return ReferenceData(tuple(tables), settings, seconds, materials, plan)


def check_reference(scene: Scene, table: TransportTable) -> None:
    """Refuse a table that is no reference of ``scene``.

    Raises:
        TableError: it is of another scene or level.
    """
    if table.scene_hash != scene.hash or table.level != "reference":
        raise TableError(
            f"the table is of level {table.level!r} and scene {table.scene_hash or 'unknown'}, "
            f"allowed: level 'reference' of scene {scene.hash}: leave the table out to render one",
            field="table",
        )


def data_hash(table: TransportTable) -> str:
    """Return the SHA-256 of the numbers in ``table``, whatever file they are in."""
    digest = hashlib.sha256(table.scene_hash.encode())
    for values in (table.phi, table.bends, table.T, table.se, table.background):
        if values is not None:
            digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
    return digest.hexdigest()
