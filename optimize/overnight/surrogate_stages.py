"""The stages that make the surrogate: trial renders, the transport table, the fit.

A pass of the table renders every bend, pressed and untouched, with a seed of its own; the passes'
weighted mean is the table. In every pass the scene's own bends come first, pressed before
untouched, because all scores are made of them, then the bends between. A model that is whole and
was logged is not fitted again; a damaged one is, and comes out the same.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from optimize.design import RUN_MODEL, Array
from optimize.overnight.context import (
    FIT_STEPS,
    MIN_SAMPLES,
    MODEL_UNTIL,
    OVERTIME_SHARE,
    REPORT_SECONDS,
    TABLE_UNTIL,
    TIME_USED,
    UNIT_SAMPLES,
    RunContext,
    samples_within,
)
from optimize.overnight.store import TABLE
from render.errors import ModelError
from render.progress import Clock
from render.reference import (
    RenderCost,
    RenderJob,
    TimeBudget,
    samples_per_pass,
    transport_estimate,
    transport_jobs,
    trial_cost,
)
from render.scene import Scene, unchecked
from render.transport import TransportTable, mean_table
from surrogate.model.preview_grid import direction_nodes
from surrogate.runtime import MODEL_FILE, Checker, sha256
from surrogate.training.render_plan import estimate_table, training_bends

if TYPE_CHECKING:  # torch comes with it
    from surrogate.train import TrainConfig

PHI_NODES = 11
BEND_NODES = 3, 5
"""Bends of the table besides the scene's own, of a short run and of a long one: the latter's model
knows the bends between as well."""
LONG = 1.0, 2000
"""Hours, or samples, of a long run."""
JOB_SECONDS = 90.0
"""A render of the table lasts about so long: what a worker that dies can lose."""
MIN_PASSES = 3
"""A table is rendered in so many passes at least, so that a slow machine can do with fewer."""
ROUNDS_AND_BATCHES = 4
"""Rounds, and batches of the final verification, that a night has at least."""
PILOT_PURPOSE, TABLE_PURPOSE = 1, 2


def measure_cost(context: RunContext) -> RenderCost:
    """Return how fast renders are here, by trial renders at the first bend.

    Where the hours are too few for the least work, that is said at once.
    """

    def trial() -> RenderCost:
        context.stage("Trial renders", "trial")
        phi = direction_nodes(context.scene, PHI_NODES)
        seed = context.random_seed(PILOT_PURPOSE, 0)
        # A short night must not spend itself on them.
        jobs_of_table = 2 * len(context.bends) * MIN_PASSES
        seconds = context.seconds_until(TABLE_UNTIL)
        unit = samples_per_pass(context.scene, seconds, jobs_of_table)
        jobs = transport_jobs(
            context.scene, phi, context.bends[:1], samples=unit, per_pass=unit, seeds=[seed]
        )

        def render(trial: list[RenderJob]) -> list[float]:
            clock = Clock(sum(job.samples for job in trial), context.progress)
            return [result.seconds for job in trial for result in context.renders([job], clock)]

        return trial_cost(jobs, render)

    known = context.decided("cost") is not None
    cost = _cost_of(context, context.decide("cost", trial))
    if not known:
        hours = TimeBudget(context.until - context.began, context.began, context.store.spent)
        if said := hours.warning(_least_seconds(context, cost)):
            context.log.note(said)
    return cost


def _least_seconds(context: RunContext, cost: RenderCost) -> float:
    """Return what the fewest samples, steps, rounds and batches take from here on."""
    from surrogate.train import TrainConfig, training_cost

    fit = training_cost(context.scene, TrainConfig(), len(table_bends(context)))
    steps = fit.preview + fit.fit(FIT_STEPS[0])
    table = cost.seconds(_jobs(context, MIN_SAMPLES, list(range(MIN_PASSES))))
    pads = 2 * len(context.bends) * ROUNDS_AND_BATCHES
    return table + pads * cost.fixed / cost.workers + fit.per_step() * steps + REPORT_SECONDS


def _cost_of(context: RunContext, kept: dict[str, Any]) -> RenderCost:
    """Return a logged cost for the workers of this attempt."""
    return RenderCost(kept["fixed"], kept["per_sample"], context.renders.workers.count)


def render_table(context: RunContext) -> None:
    """Render this period's passes, and learn from them what renders cost."""
    kept = context.decided("table")
    if kept is None:
        _check_model_size(context)
        if context.samples is None:
            context.cost = measure_cost(context)
        kept = context.decide("table", lambda: _render_passes(context))
    context.cost = None if kept["cost"] is None else _cost_of(context, kept["cost"])


def _check_model_size(context: RunContext) -> None:
    """Refuse a scene whose model would be too large, before the night is spent on its table."""
    from surrogate.train import check_model_size

    check_model_size(*_training(context))


def _training(context: RunContext) -> tuple[Scene, TrainConfig]:
    """Return the scene and the settings that a night trains its surrogate with."""
    from surrogate.train import TrainConfig

    # The table is of the scene's own material, whatever it leaves free. Following light has no
    # share of the night; its renders tell what the shader misses.
    return unchecked(context.scene, {"free": None}), TrainConfig(coarse=True)


def _render_passes(context: RunContext) -> dict[str, Any]:
    """Return samples per cell, seeds and cost of the passes that there was time for."""
    amount = context.amount("table", lambda cost: _affordable_passes(context, cost))
    context.stage("Transport table", "table")
    seeds: list[int] = []
    group = max(1, 2 * context.renders.workers.count // (2 * len(table_bends(context))))

    def plan(_number: int, _longest: float) -> dict[str, Any]:
        last = min(len(seeds) + group, amount["passes"])
        more = [context.random_seed(TABLE_PURPOSE, i) for i in range(len(seeds), last)]
        if not more:
            return {"stop": "all passes are rendered"}
        if seeds and context.cost is not None:
            seconds = context.cost.seconds(_jobs(context, amount["samples"], more))
            # Half a pass too many is as good as half a pass too few.
            if seconds / 2 > context.seconds_until(TABLE_UNTIL):
                return {"stop": TIME_USED}
        return {"seeds": more}

    def work(_number: int, decided: dict[str, Any]) -> None:
        began = context.store.spent()
        jobs = _jobs(context, amount["samples"], decided["seeds"])
        clock = Clock(sum(job.samples for job in jobs), context.progress)
        context.renders(jobs, clock)
        if context.cost is not None and clock.worked == clock.total:
            # From here on what was seen counts, not what the trial predicted.
            ratio = (context.store.spent() - began) / context.cost.seconds(jobs)
            fixed, each = context.cost.fixed * ratio, context.cost.per_sample * ratio
            context.cost = RenderCost(fixed, each, context.cost.workers)
        seeds.extend(decided["seeds"])

    context.steps("table pass", plan, work, context.deadline(TABLE_UNTIL + OVERTIME_SHARE))
    return {"samples": amount["samples"], "seeds": seeds, "cost": context.cost}


def _affordable_passes(context: RunContext, cost: RenderCost) -> dict[str, int]:
    unit = _jobs(context, UNIT_SAMPLES, [0])
    work = max(context.seconds_until(TABLE_UNTIL), 1.0) * cost.workers
    shared = -(-MIN_PASSES * cost.workers // len(unit)) if cost.workers > 1 else 0
    passes = max(MIN_PASSES, shared, round(work / (JOB_SECONDS * len(unit))))
    samples = samples_within(cost, unit, work / passes / min(cost.workers, len(unit)))
    return {"passes": passes, "samples": samples}


def pooled_table(context: RunContext) -> TransportTable:
    """Return the mean of all passes of all periods so far, weighted by their samples."""
    tables, samples = [], []
    for number in range(1, context.number + 1):
        passes = context.store.decided(f"{number}/table")
        for seed in passes["seeds"]:
            jobs = _jobs(context, passes["samples"], [seed])
            results = context.renders(jobs, Clock(sum(job.samples for job in jobs), None))
            estimate = transport_estimate(context.scene, jobs, results, passes["samples"])
            phi, bends = np.array(jobs[0].phi[0]), dict.fromkeys(job.bend for job in jobs)
            tables.append(estimate_table(context.scene, phi, np.array(list(bends)), estimate))
            samples.append(passes["samples"])
    return mean_table(tables, samples)


def table_bends(context: RunContext) -> Array:
    """Return the bends of the table in rad: the scene's own ones first, then those between.

    The first period chooses, because all passes must have the same.
    """

    def choose() -> int:
        if context.samples is not None:
            return BEND_NODES[context.samples >= LONG[1]]
        return BEND_NODES[context.until - context.began >= 3600 * LONG[0]]

    nodes = context.store.decide("bend nodes", choose)
    wanted = context.bends
    between = [b for b in training_bends(context.scene, nodes) if np.abs(wanted - b).min() > 1e-6]
    return np.concatenate([wanted, between])


def _jobs(context: RunContext, samples: int, seeds: list[int]) -> list[RenderJob]:
    phi, bends = direction_nodes(context.scene, PHI_NODES), table_bends(context)
    jobs = transport_jobs(context.scene, phi, bends, samples=samples, seeds=seeds)
    ranks = {bend: int(i >= len(context.bends)) for i, bend in enumerate(bends.tolist())}
    return sorted(jobs, key=lambda job: (seeds.index(job.seed), ranks[job.bend], not job.indented))


def fit_model(context: RunContext, table: Callable[[], TransportTable]) -> Checker:
    """Return the surrogate that is fitted to ``table``, which is read only where it is needed."""
    folder = context.store.run / RUN_MODEL
    known = context.decided("model")
    if known is not None:
        fitted = _whole(context, known["sha256"])
        if fitted is not None:
            return fitted
        context.log.note(f"{folder} is missing or damaged: the surrogate is fitted again")
    from surrogate.train import train

    context.stage("Surrogate", "surrogate")
    scene, config = _training(context)
    fit = context.amount("fit", lambda _: {"steps": _affordable_steps(context, scene, config)})
    network = replace(config.fit.network, steps=fit["steps"])
    train(
        scene,
        folder,
        seed=context.seed,
        table=table(),
        run=context.store.run / TABLE,
        config=replace(config, fit=replace(config.fit, network=network)),
        command=f"tactilux overnight {context.scene.name} --seed {context.seed}",
        progress=context.progress,
    )
    digest = sha256((folder / MODEL_FILE).read_bytes())
    refitted = _whole(context, context.decide("model", lambda: {"sha256": digest})["sha256"])
    if refitted is None:
        raise ModelError(
            f"{folder} was fitted again to the same renders and came out different: this is "
            "another processor type or another version; start anew in another directory",
            field="model",
        )
    return refitted


def _whole(context: RunContext, digest: str) -> Checker | None:
    """Return the model in the run directory if it is the one of that SHA-256."""
    folder = context.store.run / RUN_MODEL
    with suppress(OSError, ModelError):
        if sha256((folder / MODEL_FILE).read_bytes()) == digest:
            return Checker.load(folder, context.scene.hash)
    return None


def _affordable_steps(context: RunContext, scene: Scene, config: TrainConfig) -> int:
    """Return the steps of the networks that fit the time, after the preview is drawn."""
    from surrogate.train import training_cost

    cost = training_cost(scene, config, len(table_bends(context)))
    per_step = cost.per_step()
    free = context.seconds_until(MODEL_UNTIL) - per_step * cost.preview
    return cost.affordable(free, per_step, FIT_STEPS[0])
