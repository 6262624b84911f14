"""Making a model: preview table, reference renders, fit, held-out errors, export."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from render.chebyshev import interpolation_weights
from render.choose_exposure import ScoreScale, baseline_power, scene_scale
from render.errors import TableError
from render.finished_parts import FinishedParts
from render.geometry import counted_sites
from render.levels import NETWORK
from render.metric import THESIS, superposed
from render.progress import OnProgress, Progress, in_stage
from render.reference import TimeBudget, check_rendered
from render.scene import Scene
from render.transport import TransportTable
from surrogate.export.model_card import Provenance, describe_model, write_card
from surrogate.export.package import check_size, write_package
from surrogate.model.checker_module import CheckerModule
from surrogate.model.facet_basis import SIZE
from surrogate.model.features import feature_names
from surrogate.model.materials import MaterialRange
from surrogate.model.preview_grid import (
    MATERIALS,
    PreviewGrid,
    direction_nodes,
    draw_grid,
    draw_material_grid,
    grid_nodes,
    interpolation_error,
    is_one_node,
)
from surrogate.preview_model import preview_half_width, preview_nodes
from surrogate.runtime import ModelMetadata
from surrogate.training.evaluation import scene_bends
from surrogate.training.fit import Fit, fit_residual
from surrogate.training.fit_table import fit_table
from surrogate.training.fit_task import VERSION, FitConfig, FitTask
from surrogate.training.fit_time import MIN_STEPS, FitTime, TrainingCost
from surrogate.training.render_plan import (
    ReferenceData,
    RenderTime,
    check_reference,
    render_longer,
    render_reference,
    rendered_seconds,
    training_bends,
)
from surrogate.training.table_allocation import table_shares
from surrogate.training.training_preview import TrainingPreview, followed_grid

PREVIEW_NODES = 11, 9
"""Nodes of a model's preview in phi and bend."""
MAX_INTERPOLATION_ERROR = 0.01
"""Of the preview between its nodes, relative, median over cells, from which it gets more nodes."""


@dataclass(frozen=True)
class TrainConfig:
    """What is rendered and fitted.

    Arguments:
        minutes: time for everything together, which decides the samples and the networks' steps;
            where lamps cannot turn, samples go where they move scores.
        samples: samples per (fiber, facet) pair instead; the same number on any machine.
        phi_nodes, bend_nodes: nodes of the reference.
        preview_nodes: nodes of the preview in phi and bend; None for `PREVIEW_NODES`, and more in
            phi where beams are narrow.
        coarse: take the preview as the shader draws it; otherwise it is converged where the scene
            has one material and time allows.
        materials, preview_materials: how many materials are rendered, and drawn by the preview,
            where the scene leaves its material free.
        fit: the residual.
    """

    minutes: float = 40.0
    samples: int | None = None
    phi_nodes: int = 11
    bend_nodes: int = 5
    preview_nodes: tuple[int, int] | None = None
    coarse: bool = False
    materials: int = 8
    preview_materials: int = MATERIALS
    fit: FitConfig = field(default_factory=FitConfig)


@dataclass(frozen=True)
class Trained:
    """A finished model: where it is, what it says about itself, its fit and its training data.

    ``baseline_counts`` is what the rendered baseline reaches, noise included, where the preview's
    has 230 counts: the scale is the preview's, and agrees with the renders where both are near.
    """

    folder: Path
    metadata: ModelMetadata
    fit: Fit
    table: TransportTable
    seconds: float
    baseline_counts: float


def train(
    scene: Scene,
    out: Path,
    *,
    seed: int = 0,
    table: TransportTable | None = None,
    run: Path | None = None,
    config: TrainConfig | None = None,
    command: str = "",
    began: float | None = None,
    progress: OnProgress | None = None,
) -> Trained:
    """Make the model of ``scene`` in the folder ``out``; all its files appear together.

    Deterministic for a seed, a number of samples and a processor type; ended at any instant, it
    goes on when asked again. Minutes are those of everything, start-up and fit included; the
    samples and steps that they came to are kept in ``run``, so that the same minutes make the same
    model again.

    Arguments:
        scene: the sensor.
        out: model folder; an older model in it is replaced.
        seed: of renders, folds, networks and held-out designs.
        table: a reference table with background to fit to, instead of rendering one.
        run: directory where interrupted renders and fits go on (default: beside ``out``); the
            finished table is ``reference.npz`` in it.
        config: nodes, samples and network.
        command: the command line, for the model card.
        began: ``time.monotonic()`` from which minutes count (default: now).
        progress: called as the work goes on.

    Raises:
        TableError: a table that does not fit the scene.
        RenderError, CompilerError, GraphicsError: from the renderers.
        ModelError: ``out`` holds files that are no model, or the model would be too large.
    """
    config = config or TrainConfig()
    run = run or out.parent / f"{out.name}-training"
    if table is not None:
        _check(scene, table)
    check_rendered(scene, scene.state_axis)
    check_model_size(scene, config)
    began = time.monotonic() if began is None else began
    fit_time = None
    report = progress or (lambda _: None)
    report(Progress(0, 1, stage="preview"))
    if table is None and config.samples is None:
        fit_time = _fit_time(scene, run, seed, config, began)
        report(Progress(0, 1, stage="preview", note=fit_time.warning()))
    scale = scene_scale(scene)
    preview = _preview(scene, run / "fit", config, scale, fit_time, progress)
    report(Progress(1, 1, stage="preview"))

    before = rendered_seconds(run)
    reference = _reference(scene, table, run, seed, config, fit_time, preview.grid, scale, progress)

    def fitted(reference: ReferenceData, networks: bool) -> tuple[Fit, PreviewGrid, float]:
        reference.scaled(scale.exposure, scale.lam).save(run)
        fitting, cells = time.monotonic(), reference.cells(scene)
        task = FitTask(
            scene=scene,
            grid=preview.grid,
            cells=cells,
            exposure=scale.exposure,
            lam=scale.lam,
            bends=scene_bends(reference.tables[0], scene.state_axis),
            seed=seed,
            config=config.fit,
            time=fit_time,
            folder=run / "fit",
            networks=networks,
            preview_half_width=preview.half_width,
        )
        if is_one_node(scene) and cells.half_difference is not None:
            fit, grid = fit_table(task)
        else:
            fit, grid = fit_residual(task, progress), preview.grid
        return fit, grid, time.monotonic() - fitting

    fit, grid, fit_seconds = fitted(reference, True)
    if fit_time is not None and fit.kind != NETWORK:
        # Networks that the renders do not bear out leave their time to more renders.
        left = fit_time.without_networks(rendered_seconds(run) - before)
        longer = render_longer(scene, run, reference, left, progress)
        if longer is not None:
            reference = longer
            fit, grid, again = fitted(reference, False)
            fit_seconds += again
    reference = reference.scaled(scale.exposure, scale.lam)

    report(Progress(0, 1, stage="export"))
    about = describe_model(scene, preview, reference, fit)
    graph = CheckerModule(
        scene, grid, fit.residual, exposure=scale.exposure, lam=scale.lam, spread=fit.spread
    )
    made = Provenance(
        command=command or f"tactilux train {scene.name} --seed {seed}",
        seed=seed,
        seconds={"rendering": reference.seconds, "fitting": fit_seconds},
    )
    card, golden = write_card(about, fit, made), _golden_inputs(scene, seed)
    write_package(out, graph, about, card, golden, made.seconds)
    report(Progress(1, 1, stage="export"))
    seconds = time.monotonic() - began
    return Trained(
        out, about, fit, reference.tables[0], seconds, _baseline_counts(scene, reference.tables[0])
    )


def _baseline_counts(scene: Scene, table: TransportTable) -> float:
    """Return the 99.5th percentile of the baseline's counts in ``table`` at the least bend."""
    light = table.at(np.full(scene.lamp_count, np.pi / 2))
    at_bend = interpolation_weights(table.bends, np.array([min(scene.state_axis)]))[0]
    light = np.einsum("b,fbsk...->fsk...", at_bend, light)[:, None]
    counts = table.exposure * superposed(light, baseline_power(scene))
    return float(np.percentile(counts, THESIS.exposure_percentile))


def _preview(
    scene: Scene,
    folder: Path,
    config: TrainConfig,
    scale: ScoreScale,
    fit_time: FitTime | None,
    progress: OnProgress | None,
) -> TrainingPreview:
    """Return the preview; what is finished of it is kept in ``folder``."""
    about = (
        VERSION, scene.hash, scene.free, config.preview_nodes, config.preview_materials,
        config.coarse,
    )  # fmt: skip
    parts = FinishedParts(folder, hashlib.sha256(repr(about).encode()).hexdigest())
    kept = TrainingPreview.load(parts, MaterialRange.of(scene))
    preview = kept or _drawn(scene, config, progress)
    drawn, asked = preview.grid, np.inf if fit_time is None else config.minutes
    # Under a window the shader lacks up to a third of the light.
    coarse = config.coarse and not scene.window_refracts
    if drawn.free is None and not coarse and preview.may_converge(scene, asked):
        following = in_stage(progress, "following light")
        within = None if fit_time is None else fit_time.budget.seconds
        grid = followed_grid(drawn, scene, within, following)
        converged = grid is not drawn
        gave_up = 0.0 if converged else asked
        preview = replace(preview, grid=grid, converged=converged, gave_up=gave_up)
    elif kept is not None:
        return kept
    if drawn.free is None:
        followed = preview.grid if preview.converged else None
        half_width = preview_half_width(scene, scale, drawn, followed)
        preview = replace(preview, half_width=half_width)
    preview.save(parts)
    return preview


def _drawn(scene: Scene, config: TrainConfig, progress: OnProgress | None) -> TrainingPreview:
    """Return the preview as the shader draws it, at nodes that its beams need."""
    told, nodes = in_stage(progress, "preview"), config.preview_nodes or PREVIEW_NODES
    drawn, left_out = draw_material_grid(
        scene, *nodes, materials=config.preview_materials, progress=told
    )
    error = interpolation_error(scene, drawn)
    narrow = error.median > MAX_INTERPOLATION_ERROR and any(scene.turning)
    if narrow and config.preview_nodes is None and drawn.free is None:
        # As many as a preview that stands alone.
        check_model_size(scene, replace(config, preview_nodes=preview_nodes(scene)))
        drawn = draw_grid(scene, *preview_nodes(scene), told)
        error = interpolation_error(scene, drawn)
    return TrainingPreview(drawn, error, left_out)


def _check(scene: Scene, table: TransportTable) -> None:
    """Refuse a table that the model cannot be made of, before anything is drawn."""
    check_reference(scene, table)
    if scene.states is not None:
        if tuple(table.bends) != scene.state_axis:
            raise TableError(
                f"the reference table has the states {table.bends.tolist()}, allowed: the numbers "
                f"of the scene's, 0 to {len(scene.state_axis) - 1}",
                field="bends",
            )
        return
    angles = np.degrees(scene.state_axis)
    low, high = np.degrees(table.bends.min()), np.degrees(table.bends.max())
    if angles.min() < low - 1e-6 or angles.max() > high + 1e-6:
        raise TableError(
            f"the reference table spans bends {low:g} to {high:g} deg, allowed: the scene's "
            f"{angles.min():g} to {angles.max():g} deg",
            field="bends",
        )
    if MaterialRange.of(scene) is not None:
        raise TableError(
            f"scene {scene.name} leaves its material free, and a table knows one material: "
            "train without a table, or leave the section free out of the scene",
            field="free",
        )


def check_model_size(scene: Scene, config: TrainConfig) -> None:
    """Refuse a scene whose model would be too large, networks included, before it is rendered."""
    phi, bends = grid_nodes(scene, *(config.preview_nodes or PREVIEW_NODES))
    free, fit = MaterialRange.of(scene), config.fit
    width = fit.network.width
    inputs = len(feature_names(scene)) + (0 if free is None else len(free.names))
    each = (inputs + 1) * width + (width + 1) * width + (width + 1) * SIZE
    check_size(
        scene,
        len(phi),
        len(bends),
        terms=0 if free is None else len(free.exponents),
        weights=0 if is_one_node(scene) else fit.members * each,
    )


def training_cost(scene: Scene, config: TrainConfig, bends: int) -> TrainingCost:
    """Return what a training of ``scene`` on renders at ``bends`` bends takes."""
    free = MaterialRange.of(scene)
    phi, bend = grid_nodes(scene, *(config.preview_nodes or PREVIEW_NODES))
    drawn = len(phi) * len(bend)
    directions = len(direction_nodes(scene, config.phi_nodes))
    directions *= 1 if free is None else config.materials
    fibers, copies, network = scene.lamp_count, len(scene.albedos), config.fit.network
    if is_one_node(scene):
        network = replace(network, steps=MIN_STEPS)  # there are none
    return TrainingCost(
        draws=fibers * drawn * (1 if free is None else config.preview_materials),
        jobs=2 * bends * copies * (1 if free is None else config.materials),
        directions=directions,
        rows=directions * bends * fibers * copies * len(counted_sites(scene)),
        normals=scene.indenter.faces + 1,
        splits=2 + (bends > 2 and scene.states is None),
        members=config.fit.members,
        network=network,
    )


def _fit_time(scene: Scene, run: Path, seed: int, config: TrainConfig, began: float) -> FitTime:
    """Return what keeps renders and fit within the minutes."""
    request = {"scene_hash": scene.hash, "minutes": config.minutes, "seed": seed}
    cost = training_cost(scene, config, len(training_bends(scene, config.bend_nodes)))
    return FitTime(TimeBudget.of_minutes(config.minutes, began), run / "fit.json", request, cost)


def _reference(
    scene: Scene,
    table: TransportTable | None,
    run: Path,
    seed: int,
    config: TrainConfig,
    fit_time: FitTime | None,
    grid: PreviewGrid,
    scale: ScoreScale,
    progress: OnProgress | None,
) -> ReferenceData:
    """Return the reference, rendered unless ``table`` is given."""
    free = MaterialRange.of(scene)
    if table is not None:
        return ReferenceData((table,), {"source": "an existing reference table"})
    shares = None
    if fit_time is not None and free is None and is_one_node(scene):
        phi = direction_nodes(scene, config.phi_nodes)
        bends = training_bends(scene, config.bend_nodes)
        shares = table_shares(scene, grid, phi, bends, scale)
    return render_reference(
        scene,
        run,
        seed=seed,
        samples=config.samples,
        phi_count=config.phi_nodes,
        bend_count=config.bend_nodes,
        materials=None if free is None else free.samples(config.materials),
        within=None if fit_time is None else RenderTime(fit_time.budget, fit_time.reserve),
        shares=shares,
        progress=progress,
    )


def _golden_inputs(scene: Scene, seed: int) -> dict[str, NDArray[np.float32]]:
    """Return three random designs at the scene's bends, float32, as the graph takes them."""
    rng = np.random.default_rng([seed, 99])
    fibers, channels = scene.lamp_count, len(scene.palette.channels)
    inputs = {
        "phi": rng.uniform(0.0, np.pi, (3, fibers)).astype(np.float32),
        "power": rng.uniform(0.0, 1.0, (3, fibers, channels)).astype(np.float32),
        "bend": np.tile(np.array(scene.state_axis, dtype=np.float32), (3, 1)),
    }
    free = MaterialRange.of(scene)
    if free is not None:
        unit = rng.uniform(-1.0, 1.0, (3, len(free.names)))
        inputs["material"] = free.from_unit(unit).astype(np.float32)
    return inputs
