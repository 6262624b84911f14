"""The frontier: every level predicts the same held-out designs and meets one long reference."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optimize.design import ScoreSettings
from optimize.frontier.held_out import FrontierRow, HeldOutDesigns, HeldOutReference
from render.progress import OnProgress, Progress, in_stage
from render.reference import (
    RenderCost,
    TimeBudget,
    growing_cost,
    render_within,
    samples_per_pass,
    stored_plan,
    transport_jobs,
)
from render.reference.path_tracer import PathTracer
from render.scene import Scene
from render.transport import TransportTable
from surrogate.runtime import Checker
from surrogate.training.conformal import Coverage

if TYPE_CHECKING:  # torch comes with it
    from surrogate.train import TrainConfig

PLAN, TRACER_PLAN = "plan.json", "volpath.json"
SHORT_DIVISORS = (32, 8)
"""How many times fewer samples the short rendered rows get than the reference."""
TRACER_SAMPLES = (4, 16)
"""Samples per pixel of the path tracer's rows."""
TABLE_DIVISOR = 2
"""How many times fewer samples a transport table gets, where none is given."""
PATH_TRACER_FRACTION = 0.15
"""Part of the time that is planned for the path tracer; being last, it gets what is left."""
SMALL_STEPS_COST, SMALL_STEPS_COMPILING = 2.5, 2.0
"""What small steps of Markov chains cost over plain samples, and their kernels over those."""
COMPILING_FRACTION = 0.25
"""Part of the time that the kernels of small steps may take; else their row is left out."""
NO_SMALL_STEPS = (
    "{:g} minutes have no row of PSSMLT: its kernels alone would compile for more than a quarter "
    "of that; more --minutes have one"
)
REFERENCE, REFERENCE_SEED, RENDERS = "Reference", 101, "renders"
"""The long render: what it is called, its seed (training counts from 1), and its folder."""


@dataclass(frozen=True)
class FrontierPlan:
    """What is rendered; kept in the run directory, so that a resumed run renders the same.

    Arguments:
        scene_hash, seed, designs: whose designs, which, and how many.
        minutes: that the rest was chosen for; 0 when ``samples`` were given.
        samples, short: per fiber and facet, of the reference and of the short rows.
        per_pass: of ``transport_jobs``, of all renders; None when ``samples`` were given.
        small_steps: whether a short row is also made by PSSMLT.
    """

    scene_hash: str
    seed: int
    designs: int
    minutes: float
    samples: int
    per_pass: int | None
    small_steps: bool
    short: list[int]


@dataclass(frozen=True)
class TracerPlan:
    """What the path tracer has time for at the end: samples per pixel of its rows, kept too."""

    scene_hash: str
    seed: int
    designs: int
    minutes: float
    spp: list[int]


@dataclass(frozen=True)
class Frontier:
    """The rows from quick to slow, and the reference that they are compared with.

    ``noise`` is what a perfect level would show; ``seconds_alone`` those of a short render of one
    design by itself, compiling included; ``nominal`` the coverage that the model's intervals state,
    beside the measured one.
    """

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
            "scene": self.reference.designs.scene.name,
            "scene_hash": self.plan.scene_hash,
            "rows": [asdict(row) for row in self.rows],
            "intervals": {"nominal": self.nominal, **asdict(self.coverage)},
            "reference": self.reference.to_json()
            | {
                "seed": REFERENCE_SEED,
                "samples": self.plan.samples,
                "designs": self.plan.designs,
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
    budget: TimeBudget,
    samples: int | None,
    table: TransportTable | None,
    report: OnProgress,
) -> Frontier:
    """Render, fit, time and compare; everything that took long is kept in ``folder``.

    Exposure and lambda are those of ``checker``. ``count`` designs are drawn with ``seed``;
    ``samples`` per fiber and facet of the reference say how much is rendered, or the ``budget`` of
    everything does. The fits go on ``table``, which is rendered here where there is none.

    Raises:
        TableError: a table of another scene or level.
        RenderError, CompilerError, GraphicsError: from the renderers.
    """
    from optimize.frontier import levels
    from surrogate.model.preview_grid import draw_grid
    from surrogate.preview_model import preview_checker
    from surrogate.train import TrainConfig
    from surrogate.training.render_plan import check_reference, data_hash, render_reference

    config = TrainConfig()
    if table is not None:
        check_reference(scene, table)
    designs, renders = HeldOutDesigns.of(scene, count, seed), folder / RENDERS
    # Light is followed before the renders get the time that is left.
    began = time.perf_counter()
    converged = preview_checker(scene, report)
    following = time.perf_counter() - began
    report(Progress(0, 1, stage="plan"))
    plan = make_frontier_plan(
        designs,
        folder,
        seed,
        budget,
        samples,
        renders_table=table is None,
        fit_seconds=lambda: _fit_seconds(scene, config),
        report=report,
    )
    if not plan.small_steps:
        report(Progress(0, 1, stage="plan", note=NO_SMALL_STEPS.format(plan.minutes)))
    rendered = designs.render(
        REFERENCE, plan.samples, REFERENCE_SEED, renders, report, per_pass=plan.per_pass
    )
    settings = ScoreSettings(checker.exposure, checker.lam)
    reference = HeldOutReference.of(designs, rendered, settings)
    if table is None:
        made = render_reference(
            scene,
            folder / "table",
            seed=seed,
            samples=_part(plan.samples, TABLE_DIVISOR, plan.per_pass),
            per_pass=plan.per_pass,
            phi_count=config.phi_nodes,
            bend_count=len(scene.bending.angles),
            progress=in_stage(report, "transport table"),
        )
        table, table_seconds = made.tables[0], float(str(made.renderer["seconds"]))
    else:
        about = checker.metadata
        same = about.training_data_hash == data_hash(table)
        table_seconds = float(about.renderer.get("seconds", 0.0)) if same else 0.0
    report(Progress(0, 1, stage="preview"))
    rows = [levels.preview_row(reference), levels.converged_row(reference, converged, following)]
    began = time.perf_counter()
    grid = draw_grid(scene, *config.preview_nodes)
    drawing = time.perf_counter() - began
    rows += levels.fitted_rows(reference, grid, table, seed, config.fit, folder, report)
    report(Progress(0, 1, stage="shipped model"))
    rows += levels.model_rows(reference, checker, drawing)
    rows.append(levels.table_row(reference, table, table_seconds))
    rows += levels.short_rows(
        reference, plan.short, renders, report, plan.per_pass, small_steps=plan.small_steps
    )
    short, short_seed = plan.short[-1], levels.SHORT_SEED
    alone = replace(designs, phi=designs.phi[:1], colors=designs.colors[:1]).render(
        "One design", short, short_seed, renders, report, per_pass=plan.per_pass
    )
    spp = _tracer_samples(designs, plan, folder, budget)
    rows += levels.path_tracer_rows(reference, spp, folder / "volpath", report)
    return Frontier(
        plan=plan,
        rows=tuple(rows),
        noise=reference.noise_row(seed),
        reference=reference,
        seconds_alone=alone.seconds,
        nominal=checker.coverage,
        coverage=reference.coverage(checker),
    )


def make_frontier_plan(
    designs: HeldOutDesigns,
    folder: Path,
    seed: int,
    budget: TimeBudget,
    samples: int | None,
    *,
    renders_table: bool,
    fit_seconds: Callable[[], float],
    report: OnProgress | None = None,
) -> FrontierPlan:
    """Return the plan in ``folder`` when it answers the same request, or a new one.

    Unless ``samples`` of the reference, per fiber and facet, are given, it is rendered by the way
    for its part of the ``budget``; how far it comes says what everything else gets.
    ``renders_table`` says whether a transport table is part of that, ``fit_seconds`` what the fits
    take.
    """
    scene = designs.scene
    wanted: dict[str, Any] = {"scene_hash": scene.hash, "seed": seed, "designs": len(designs)}

    def make() -> FrontierPlan:
        chosen, each, spent, small_steps = samples, None, 0.0, True
        if chosen is None:
            spent = budget.seconds / 60.0
            rest = _Rest(designs, budget, fit_seconds(), renders_table)
            chosen, each = _render_for(designs, folder / RENDERS, budget, rest, report)
            small_steps = rest.has_small_steps
        short = sorted({_part(chosen, divisor, each) for divisor in SHORT_DIVISORS})
        return FrontierPlan(
            minutes=spent,
            samples=chosen,
            per_pass=each,
            small_steps=small_steps,
            short=short,
            **wanted,
        )

    given = {"minutes": budget.seconds / 60.0} if samples is None else {"samples": samples}
    return stored_plan(folder / PLAN, FrontierPlan, wanted | given, make)


def _part(samples: int, divisor: int, per_pass: int | None) -> int:
    """Return about one ``divisor``th of ``samples``, whole passes where there are any."""
    each = per_pass or 1
    return each * max(1, samples // each // divisor)


@dataclass
class _Rest:
    """What everything but the reference takes: known better once its first pass is timed.

    Arguments:
        designs, budget: what is measured, and the time of all of it.
        fits: seconds.
        renders_table: whether a transport table is rendered too.
        first_pass: seconds of the reference's first pass, kernels included; 0 before it.
    """

    designs: HeldOutDesigns
    budget: TimeBudget
    fits: float
    renders_table: bool
    first_pass: float = 0.0

    def __post_init__(self) -> None:
        self.began = self.budget.spent()

    @property
    def has_small_steps(self) -> bool:
        """Whether there is time for the kernels of small steps."""
        return self._small_steps_compiling() <= COMPILING_FRACTION * self._free()

    def reference_seconds(self) -> float:
        """Return what the reference may take."""
        return (1.0 - PATH_TRACER_FRACTION) * self._left() / (1.0 + self._cost())

    def _cost(self) -> float:
        """Return the cost of the other renders over that of the reference."""
        # The longer short render is made for one design, and once more with small steps.
        longer = 2.0 + SMALL_STEPS_COST * self.has_small_steps
        short = 1.0 / SHORT_DIVISORS[0] + longer / SHORT_DIVISORS[1]
        return short + self.renders_table / TABLE_DIVISOR

    def _free(self) -> float:
        """Return the seconds for the renders of all lights and the path tracer."""
        # One design and the table have nodes of their own, thus kernels.
        kernels = (1 + self.renders_table) * self._compiling()
        return max(self.budget.seconds - self.began - self.fits - kernels, 0.0)

    def _left(self) -> float:
        return self._free() - self.has_small_steps * self._small_steps_compiling()

    def _small_steps_compiling(self) -> float:
        return SMALL_STEPS_COMPILING * self._compiling()

    def _compiling(self) -> float:
        pads = 2 * len({bend > 0 for bend in self.designs.bends.tolist()})
        return pads * self.first_pass


def _render_for(
    designs: HeldOutDesigns,
    folder: Path,
    budget: TimeBudget,
    rest: _Rest,
    report: OnProgress | None,
) -> tuple[int, int]:
    """Render the reference for its part of the time; return its samples, and those of a pass."""

    def listen(at: Progress) -> None:
        if not rest.first_pass:
            rest.first_pass = budget.spent() - rest.began
        if report is not None:
            report(replace(at, stage=REFERENCE))

    each = samples_per_pass(designs.scene, rest.reference_seconds(), 2 * len(designs.bends))
    jobs = transport_jobs(
        designs.scene,
        designs.nodes[0],
        designs.bends,
        samples=each,
        per_pass=each,
        seeds=[REFERENCE_SEED],
    )
    units = render_within(
        jobs,
        budget,
        folder,
        reserve=lambda: budget.seconds - rest.began - rest.reference_seconds(),
        progress=listen,
    )
    return units * each, each


def _fit_seconds(scene: Scene, config: TrainConfig) -> float:
    """Return what drawing the preview and fitting ridge and networks to a table take here."""
    from surrogate.train import training_cost

    cost = replace(training_cost(scene, config, len(scene.bending.angles)), splits=0)
    return cost.per_step() * (cost.preview + cost.fit(config.fit.network.steps))


def _tracer_samples(
    designs: HeldOutDesigns, plan: FrontierPlan, folder: Path, budget: TimeBudget
) -> list[int]:
    """Return the samples per pixel of the path tracer's two rows, which fill what is left."""
    if plan.per_pass is None:
        return list(TRACER_SAMPLES)
    wanted = {name: getattr(plan, name) for name in ("scene_hash", "seed", "designs", "minutes")}

    def make() -> TracerPlan:
        cost = _tracer_cost(designs)
        first = cost.samples_within(budget.left() / len(designs), [1.0, 4.0])
        return TracerPlan(**wanted, spp=[first, 4 * first])

    return stored_plan(folder / TRACER_PLAN, TracerPlan, wanted, make).spp


def _tracer_cost(designs: HeldOutDesigns) -> RenderCost:
    """Return what a design costs the path tracer, by samples per pixel, its kernels compiled."""
    tracer = PathTracer(designs.scene)

    def seconds(spp: int) -> float:
        began = time.monotonic()
        tracer.radiance(designs.phi[0], designs.power[0], spp, seed=0)
        return time.monotonic() - began

    seconds(1)  # compiles
    return growing_cost(seconds)
