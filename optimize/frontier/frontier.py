"""The frontier: every level judges the same held-out designs and is held against one reference."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from optimize.frontier.designs import HeldOut, held_out_designs, shared_nodes
from optimize.frontier.fits import fitted_levels
from optimize.frontier.grade import Row, grade, noise_row
from optimize.frontier.intervals import Held, held_by_intervals
from optimize.frontier.levels import Level, onnx_levels, preview_level, table_level, timed
from optimize.frontier.plan import FrontierPlan, make_plan
from optimize.frontier.reference import REFERENCE_SEED, Reference, judge, render_designs
from optimize.frontier.renders import path_tracer_rows, seconds_alone, short_rows
from render.errors import TableError
from render.progress import Progress
from render.scene.schema import Scene
from render.transport import TransportTable
from surrogate.model.preview_grid import draw_grid
from surrogate.runtime.checker import Checker
from surrogate.training.reference_data import data_hash
from surrogate.training.render_plan import estimate_table, render_plan
from surrogate.training.render_plan import make_plan as make_table_plan
from surrogate.training.train import TrainConfig

Report = Callable[[str, float, float, float | None], None]
"""Called with stage, done, total and the seconds left where they are known."""


@dataclass(frozen=True)
class Frontier:
    """The rows from quick to slow, and what they were held against."""

    scene: Scene
    plan: FrontierPlan
    rows: tuple[Row, ...]
    reference: Reference
    noise: Row
    seconds_alone: float
    held: Held

    def to_json(self) -> dict[str, object]:
        """Return what programs rely on."""
        relative = np.linalg.norm(self.reference.counts_se, axis=-1)
        relative = relative / np.linalg.norm(self.reference.counts, axis=-1)
        return {
            "scene": self.scene.name,
            "scene_hash": self.scene.hash,
            "rows": [row.to_json() for row in self.rows],
            "intervals": asdict(self.held),
            "reference": {
                "level": "reference (bidirectional, MIS)",
                "sampler": "monte-carlo",
                "samples": self.reference.samples,
                "seed": REFERENCE_SEED,
                "replicates": self.reference.replicates,
                "seconds": self.reference.seconds,
                "designs": len(self.reference.scores),
                "facet_se_median": float(np.median(relative)),
                "facet_se_p95": float(np.quantile(relative, 0.95)),
                "score_se_median": float(np.median(self.reference.scores_se)),
                "scores": self.reference.scores.tolist(),
                "scores_se": self.reference.scores_se.tolist(),
                "noise": self.noise.to_json(),
                "short_render_of_one_design_seconds": self.seconds_alone,
                "short_render_samples": self.plan.short[-1],
            },
        }


def measure(
    scene: Scene,
    checker: Checker,
    folder: Path,
    *,
    count: int,
    seed: int,
    minutes: float,
    samples: int | None,
    table: TransportTable | None,
    report: Report,
    config: TrainConfig | None = None,
) -> Frontier:
    """Render, fit, time and compare; everything that took long is kept in ``folder``.

    Arguments:
        scene: the sensor.
        checker: its shipped model; exposure and lambda are its.
        folder: of the run.
        count: held-out designs.
        seed: of the designs.
        minutes: of work in all, unless ``samples`` says how much.
        samples: of the reference, per fiber and facet.
        table: reference table for the fits; rendered here where there is none.
        report: told how far the work is.
        config: nodes and networks of the fits.

    Raises:
        TableError: a table of another scene or level.
        RenderError, CompilerError, GraphicsError: from the renderers.
    """
    config = config or TrainConfig()
    if table is not None and (table.scene_hash != scene.hash or table.level != "reference"):
        raise TableError(
            f"the table is of level {table.level!r} and scene {table.scene_hash or 'unknown'}, "
            f"allowed: level 'reference' of scene {scene.hash}; leave --table out to render one",
            field="table",
        )
    designs = held_out_designs(scene, count, seed)
    nodes = shared_nodes(scene, designs)
    report("Plan", 0, 1, None)
    plan = make_plan(
        scene,
        designs,
        nodes,
        folder,
        seed=seed,
        minutes=minutes,
        samples=samples,
        renders_table=table is None,
    )
    renders = folder / "renders"

    def rendering(name: str, state: Progress) -> None:
        report(name, state.done, state.total, state.eta_seconds)

    estimate = render_designs(
        scene,
        nodes,
        samples=plan.samples,
        seed=REFERENCE_SEED,
        checkpoint=renders,
        progress=lambda state: rendering("Reference", state),
    )
    reference = judge(estimate, nodes, designs, checker.exposure, checker.lam)
    if table is None:
        table, table_seconds = _rendered_table(scene, plan, seed, folder, config, rendering)
    else:
        about = checker.metadata
        same = about.training_data_hash == data_hash(table)
        table_seconds = float(about.renderer.get("seconds", 0.0)) if same else 0.0

    report("Preview", 0, 1, None)
    rows = _quick_rows(
        scene, checker, designs, reference, table, table_seconds, seed, folder, config, report
    )
    rows += short_rows(
        scene, designs, nodes, reference, plan.short, renders, lambda name, s: rendering(name, s)
    )
    alone = seconds_alone(
        scene, designs, plan.short[-1], renders, lambda s: rendering("One design", s)
    )
    rows += path_tracer_rows(
        scene,
        designs,
        reference,
        plan.spp,
        folder / "volpath",
        lambda name, done, total: report(name, done, total, None),
    )
    noise = noise_row(reference, seed)
    held = held_by_intervals(scene, checker, designs, reference)
    return Frontier(scene, plan, tuple(rows), reference, noise, alone, held)


def _rendered_table(
    scene: Scene,
    plan: FrontierPlan,
    seed: int,
    folder: Path,
    config: TrainConfig,
    rendering: Callable[[str, Progress], None],
) -> tuple[TransportTable, float]:
    """Return a transport table at the training's nodes and the seconds of its render."""
    run = folder / "table"
    wanted = make_table_plan(
        scene,
        run,
        minutes=plan.minutes,
        samples=plan.table_samples,
        seed=seed,
        phi_count=config.phi_nodes,
        bend_count=len(scene.bending.angles),
    )
    estimate = render_plan(scene, wanted, run, lambda state: rendering("Transport table", state))
    return estimate_table(scene, wanted, estimate), estimate.seconds


def _quick_rows(
    scene: Scene,
    checker: Checker,
    designs: HeldOut,
    reference: Reference,
    table: TransportTable,
    table_seconds: float,
    seed: int,
    folder: Path,
    config: TrainConfig,
    report: Report,
) -> list[Row]:
    """Return the rows of everything that renders nothing."""

    def row(level: Level) -> Row:
        report(level.name, 0, 1, None)
        counts, seconds = timed(level, designs)
        return grade(
            reference, level.name, counts, seconds=seconds, setup=level.setup, note=level.note
        )

    exposure, lam = reference.exposure, reference.lam
    with preview_level(scene, exposure) as level:
        rows = [row(level)]
    began = time.perf_counter()
    grid = draw_grid(scene, *config.preview_nodes)
    drawing = time.perf_counter() - began
    fitted = fitted_levels(
        scene,
        grid,
        table,
        exposure=exposure,
        lam=lam,
        seed=seed,
        config=config.fit,
        folder=folder,
        progress=lambda stage, done, total: report(stage.capitalize(), done, total, None),
    )
    rows += [row(level) for level in fitted]
    rows += [row(level) for level in onnx_levels(scene, checker, drawing)]
    return [*rows, row(table_level(scene, table, exposure, table_seconds))]
