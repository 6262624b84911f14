"""The frontier: every level predicts the same held-out designs and meets one long reference."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from optimize.frontier.held_out import (
    REFERENCE_SEED,
    SHORT_SEED,
    FrontierRow,
    HeldOutReference,
    held_out_designs,
)
from optimize.frontier.plan import FrontierPlan, make_frontier_plan
from optimize.frontier.rendered_levels import path_tracer_rows, short_rows
from render.errors import TableError
from render.progress import OnProgress, Progress, in_stage
from render.scene import Scene
from render.transport import TransportTable
from surrogate.runtime import Checker
from surrogate.training.conformal import Coverage


@dataclass(frozen=True)
class Frontier:
    """The rows from quick to slow, and the reference that they are compared with.

    Arguments:
        scene: the sensor.
        plan: what was rendered.
        rows: levels with their errors and times; noise: what a perfect level would show.
        reference: the long render.
        seconds_alone: of a short render of one design by itself, compiling included.
        nominal, coverage: the coverage that the model's intervals state, and the measured one.
    """

    scene: Scene
    plan: FrontierPlan
    rows: tuple[FrontierRow, ...]
    noise: FrontierRow
    reference: HeldOutReference
    seconds_alone: float
    nominal: float
    coverage: Coverage

    def to_json(self) -> dict[str, object]:
        """Return what programs rely on."""
        return {
            "scene": self.scene.name,
            "scene_hash": self.scene.hash,
            "rows": [asdict(row) for row in self.rows],
            "intervals": {"nominal": self.nominal, **asdict(self.coverage)},
            "reference": self.reference.to_json()
            | {
                "noise": asdict(self.noise),
                "short_render_of_one_design_seconds": self.seconds_alone,
                "short_render_samples": self.plan.short[-1],
            },
        }


def measure_frontier(
    scene: Scene,
    checker: Checker,
    folder: Path,
    *,
    count: int,
    seed: int,
    minutes: float,
    samples: int | None,
    table: TransportTable | None,
    report: OnProgress,
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

    Raises:
        TableError: a table of another scene or level.
        RenderError, CompilerError, GraphicsError: from the renderers.
    """
    from optimize.frontier.levels import fitted_rows, model_rows, preview_row, table_row
    from surrogate.model.preview_grid import draw_grid
    from surrogate.train import TrainConfig
    from surrogate.training.render_plan import data_hash, render_reference

    config = TrainConfig()
    if table is not None and (table.scene_hash != scene.hash or table.level != "reference"):
        raise TableError(
            f"the table is of level {table.level!r} and scene {table.scene_hash or 'unknown'}, "
            f"allowed: level 'reference' of scene {scene.hash}; leave --table out to render one",
            field="table",
        )
    designs, renders = held_out_designs(scene, count, seed), folder / "renders"
    report(Progress(0, 1, stage="plan"))
    plan = make_frontier_plan(
        designs, folder, seed=seed, minutes=minutes, samples=samples, renders_table=table is None
    )
    estimate = designs.render(
        "Reference", samples=plan.samples, seed=REFERENCE_SEED, checkpoint=renders, report=report
    )
    reference = HeldOutReference.of(estimate, designs, checker.exposure, checker.lam)
    if table is None:
        made = render_reference(
            scene,
            folder / "table",
            seed=seed,
            minutes=plan.minutes,
            samples=plan.table_samples,
            phi_count=config.phi_nodes,
            bend_count=len(scene.bending.angles),
            materials=None,
            progress=in_stage(report, "transport table"),
        )
        table, table_seconds = made.tables[0], float(str(made.renderer["seconds"]))
    else:
        about = checker.metadata
        same = about.training_data_hash == data_hash(table)
        table_seconds = float(about.renderer.get("seconds", 0.0)) if same else 0.0
    report(Progress(0, 1, stage="preview"))
    rows = [preview_row(reference)]
    began = time.perf_counter()
    grid = draw_grid(scene, *config.preview_nodes)
    drawing = time.perf_counter() - began
    rows += fitted_rows(reference, grid, table, seed, config.fit, folder, report)
    report(Progress(0, 1, stage="shipped model"))
    rows += model_rows(reference, checker, drawing)
    rows.append(table_row(reference, table, table_seconds))
    rows += short_rows(reference, plan.short, renders, report)
    alone = replace(designs, nodes=designs.phi[:1].T).render(
        "One design", samples=plan.short[-1], seed=SHORT_SEED, checkpoint=renders, report=report
    )
    rows += path_tracer_rows(reference, plan.spp, folder / "volpath", report)
    return Frontier(
        scene=scene,
        plan=plan,
        rows=tuple(rows),
        noise=reference.noise_row(seed),
        reference=reference,
        seconds_alone=alone.seconds,
        nominal=checker.coverage,
        coverage=reference.coverage(checker),
    )
