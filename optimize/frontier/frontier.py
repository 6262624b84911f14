"""The frontier: every level predicts the same held-out designs and meets one long reference."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from optimize.frontier.held_out import NOMINAL, FrontierRow, HeldOutDesigns, HeldOutReference
from optimize.frontier.predictors import LEARNED, make_predictors
from render.errors import RenderError
from render.progress import OnProgress, Progress
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
from surrogate.runtime import Checker

PLAN, TRACER_PLAN = "plan.json", "volpath.json"
SHORT_DIVISORS = (32, 8)
"""How many times fewer samples the short rendered rows get than the reference."""
TRACER_SAMPLES = (4, 16)
"""Samples per pixel of the path tracer's rows."""
FEW_DIVISOR = 8
"""How many times fewer samples the model of few renders gets, where samples are given."""
FEW_FRACTION, FEW_MINUTES = 0.25, 5.0
"""Part of the time that the model of few renders may take, and minutes at most."""
PATH_TRACER_FRACTION = 0.15
"""Part of the time that is planned for the path tracer; being last, it gets what is left."""
SMALL_STEPS_COST, SMALL_STEPS_COMPILING = 2.5, 2.0
"""What small steps of Markov chains cost over plain samples, and their kernels over those."""
COMPILING_FRACTION = 0.25
"""Part of the time that the kernels of small steps may take; else their row is left out."""
NO_SMALL_STEPS = (
    "its kernels alone would compile for more than a quarter of {:g} minutes; more --minutes have "
    "one"
)
SHORT_RUNG = "1/{} of the reference"
"""Name of a short rendered row that all scenes share."""
REFERENCE, REFERENCE_SEED, RENDERS = "Reference", 101, "renders"
"""The long render: what it is called, its seed (training counts from 1), and its folder."""


@dataclass(frozen=True)
class FrontierPlan:
    """What is rendered; kept in the run directory, so that a resumed run renders the same.

    Arguments:
        scene_hash, seed, designs: whose designs, which, and how many.
        minutes: that the rest was chosen for; 0 when ``samples`` were given.
        samples: per fiber and facet, of the reference; ``short`` of the short rows.
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
    design by itself, compiling included, None where other renderers were not asked for either;
    ``left_out`` why the scene lacks a level, by its name.
    """

    plan: FrontierPlan
    rows: tuple[FrontierRow, ...]
    noise: FrontierRow
    reference: HeldOutReference
    seconds_alone: float | None
    left_out: dict[str, str]

    def to_json(self) -> dict[str, object]:
        """Return what programs rely on."""
        return {
            "scene": self.reference.designs.scene.name,
            "scene_hash": self.plan.scene_hash,
            "rows": [asdict(row) for row in self.rows],
            "left_out": self.left_out,
            "nominal": NOMINAL,
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
    shipped: Checker | None,
    folder: Path,
    *,
    count: int,
    seed: int,
    budget: TimeBudget,
    samples: int | None,
    renderers: bool,
    report: OnProgress,
) -> Frontier:
    """Render, fit, time and compare; everything that took long is kept in ``folder``.

    Exposure and lambda are the scene's. ``count`` designs are drawn with ``seed``; ``samples`` per
    fiber and facet of the reference say how much is rendered, or the ``budget`` of everything does.

    Arguments:
        scene: the sensor.
        shipped: its trained model, if there is one.
        folder: where a later call goes on.
        count: of held-out designs.
        seed: of them and of the training.
        budget: time for everything.
        samples: per fiber and facet of the reference, instead of the budget.
        renderers: whether other renderers have rows too: PSSMLT and Mitsuba's path tracer.
        report: is told how far it is.

    Raises:
        RenderError, CompilerError, GraphicsError: from the renderers.
    """
    from optimize.frontier import levels
    from surrogate.train import TrainConfig

    designs, renders = HeldOutDesigns.of(scene, count, seed), folder / RENDERS
    few = min(FEW_FRACTION * budget.seconds / 60.0, FEW_MINUTES)
    part = None if samples is None else max(1, samples // FEW_DIVISOR)
    config = replace(TrainConfig(), minutes=few, samples=part)
    # Previews and few renders come before the reference, which gets the time that is left.
    predictors = make_predictors(scene, shipped, folder, seed, config, report)
    left_out = dict(predictors.left_out)
    report(Progress(0, 1, stage="plan"))
    plan = make_frontier_plan(designs, folder, seed, budget, samples, renderers, report=report)
    if not plan.small_steps and renderers:
        left_out["PSSMLT"] = NO_SMALL_STEPS.format(plan.minutes)
    rendered = designs.render(
        REFERENCE, plan.samples, REFERENCE_SEED, renders, report, per_pass=plan.per_pass
    )
    reference = HeldOutReference.of(designs, rendered, predictors.settings)
    report(Progress(0, 1, stage="levels"))
    rows = []
    for predictor in predictors.found:
        rows += levels.predictor_rows(reference, predictor, batches=renderers)
        if predictor.name == LEARNED and predictors.table is not None:
            rows.append(levels.table_row(reference, *predictors.table))
    names = {
        plan_samples: SHORT_RUNG.format(divisor)
        for plan_samples, divisor in zip(plan.short, SHORT_DIVISORS, strict=False)
    }
    rows += levels.short_rows(
        reference, names, renders, report, plan.per_pass, small_steps=plan.small_steps
    )
    seconds_alone = None
    if renderers:
        alone = replace(designs, phi=designs.phi[:1], colors=designs.colors[:1]).render(
            "One design", plan.short[-1], levels.SHORT_SEED, renders, report, per_pass=plan.per_pass
        )
        seconds_alone = alone.seconds
        try:
            spp = _tracer_samples(designs, plan, folder, budget)
            rows += levels.path_tracer_rows(reference, spp, folder / "volpath", report)
        except RenderError as error:  # lamps that it cannot draw
            left_out["volpath"] = str(error)
    return Frontier(
        plan=plan,
        rows=tuple(rows),
        noise=reference.noise_row(seed),
        reference=reference,
        seconds_alone=seconds_alone,
        left_out=left_out,
    )


def make_frontier_plan(
    designs: HeldOutDesigns,
    folder: Path,
    seed: int,
    budget: TimeBudget,
    samples: int | None,
    renderers: bool,
    *,
    report: OnProgress | None = None,
) -> FrontierPlan:
    """Return the plan in ``folder`` when it answers the same request, or a new one.

    Unless ``samples`` of the reference, per fiber and facet, are given, it is rendered by the way
    for its part of the ``budget``; how far it comes says what everything else gets.
    ``renderers`` says whether other renderers take part.
    """
    scene = designs.scene
    wanted: dict[str, Any] = {"scene_hash": scene.hash, "seed": seed, "designs": len(designs)}

    def make() -> FrontierPlan:
        chosen, each, spent, small_steps = samples, None, 0.0, renderers
        if chosen is None:
            spent = budget.seconds / 60.0
            rest = _Rest(designs, budget, renderers)
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
        renderers: whether other renderers take part.
        first_pass: seconds of the reference's first pass, kernels included; 0 before it.
    """

    designs: HeldOutDesigns
    budget: TimeBudget
    renderers: bool
    first_pass: float = 0.0

    def __post_init__(self) -> None:
        self.began = self.budget.spent()

    @property
    def has_small_steps(self) -> bool:
        """Whether there is time for the kernels of small steps."""
        fits = self._small_steps_compiling() <= COMPILING_FRACTION * self._free()
        return self.renderers and fits

    def reference_seconds(self) -> float:
        """Return what the reference may take."""
        kept = 1.0 - PATH_TRACER_FRACTION * self.renderers
        return kept * self._left() / (1.0 + self._cost())

    def _cost(self) -> float:
        """Return the cost of the other renders over that of the reference."""
        # The longer short render is made for one design, and once more with small steps.
        longer = 1.0 + self.renderers + SMALL_STEPS_COST * self.has_small_steps
        return 1.0 / SHORT_DIVISORS[0] + longer / SHORT_DIVISORS[1]

    def _free(self) -> float:
        """Return the seconds for the renders of all lights and the path tracer."""
        # One design has nodes of its own, thus kernels.
        kernels = self.renderers * self._compiling()
        return max(self.budget.seconds - self.began - kernels, 0.0)

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
