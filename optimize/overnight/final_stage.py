"""The final verification: finalists rendered together, with seeds that had no part in choosing.

One batch of seeds after the other until the time is used; their replicates are pooled.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from optimize.design.design import Array, Design
from optimize.overnight.budget import FIXED_SEEDS, MIN_SHARE, REPORT_SECONDS, CostModel
from optimize.overnight.context import RunContext, design_json, design_of, extended
from optimize.overnight.loop_stage import LoopOutcome
from optimize.overnight.runner import OutOfTime
from optimize.overnight.search_stage import baseline_of
from optimize.scoring.measure import measure
from optimize.scoring.score_scale import Scale
from optimize.verification.renders import DesignRenders, distinct_directions, reference_renders
from optimize.verification.verdict import Verdict
from render.reference.transport import pad_jobs

FINAL_PURPOSE = 3
MIN_BATCHES = 3
MANY_SEEDS = 16
"""From so many seeds on, the mean of each is one replicate."""
TITLES = {
    "baseline": "Baseline",
    "colors": "Colors",
    "thesis": "Thesis-style design",
    "winner": "Winner",
    "runner-up": "Runner-up",
}


def choose_finalists(
    context: RunContext, colored: Design, thesis: Design | None, loop_outcome: LoopOutcome
) -> list[tuple[str, Design]]:
    """Return who is verified, by key."""

    def choose() -> list[dict[str, Any]]:
        found = [("baseline", baseline_of(context)), ("colors", colored)]
        found += [("thesis", thesis)] if thesis is not None else []
        best = [entry.design for entry in loop_outcome.contenders[:2]]
        found += list(zip(("winner", "runner-up"), best, strict=False))
        return [{"key": key, "design": design_json(design)} for key, design in found]

    kept = context.decide("finalists", choose)
    return [(entry["key"], design_of(entry["design"])) for entry in kept]


def verify_finalists(
    context: RunContext,
    finalists: Sequence[tuple[str, Design]],
    scale: Scale,
    cost: CostModel | None,
) -> tuple[Verdict, list[tuple[int, Verdict]]]:
    """Return the verdict of all seeds, and those of the first 1, 2, 4, ... seeds.

    The finalists were chosen before the first of these seeds, so those of extensions are pooled.

    Arguments:
        context: of the run.
        finalists: designs by key, the baseline first.
        scale: of the scores.
        cost: of renders; None for a fixed amount of work.
    """
    designs = [design for _, design in finalists]
    amount = _amount(context, designs, cost)
    render = reference_renders(
        context.scene, None, lambda _, state: context.progress(state), runner=context.renders
    )
    pooled = _Pool(finalists, scale)
    checks: list[tuple[int, Verdict]] = []
    longest, number, extension = 0.0, 0, 0
    while True:
        began = context.store.spent()
        name = extended(f"final batch {number + 1}", extension)

        def another(number: int = number, longest: float = longest) -> list[int]:
            if context.fixed is not None and number == FIXED_SEEDS:
                return []
            # The last batch may end as much too late as it would end too early without it.
            if number and longest / 2 > context.seconds_left - REPORT_SECONDS:
                return []
            first = number * amount["seeds"]
            return [context.random_seed(FINAL_PURPOSE, first + i) for i in range(amount["seeds"])]

        seeds = context.decide(name, another)
        if not seeds or context.decided(f"{name} given up") is not None:
            if extension == context.extension:
                break
            extension += 1
            continue
        context.stage("Final verification", "final")
        late = (
            None if context.fixed is not None or not number else context.until - REPORT_SECONDS / 2
        )
        try:
            with context.renders.until(late):
                found = render(
                    designs, samples=amount["samples"], seeds=seeds, title="the finalists"
                )
        except OutOfTime:
            context.decide(f"{name} given up", lambda: True)
            break
        pooled.add(found, len(seeds))
        number += 1
        longest = max(longest, context.store.spent() - began)
        if number & (number - 1) == 0:
            checks.append((number, pooled.verdict()))
            _rate(context, checks[-1][1])
    if checks[-1][0] != number:
        checks.append((number, pooled.verdict()))
    _rate(context, checks[-1][1])
    return checks[-1][1], checks


class _Pool:
    """Renders of the finalists, seed by seed, and what they say together."""

    def __init__(self, finalists: Sequence[tuple[str, Design]], scale: Scale) -> None:
        self.names = tuple(name for name, _ in finalists)
        self.designs = tuple(design for _, design in finalists)
        self.scale = scale
        self.pressed: list[Array] = []
        self.untouched: list[Array] = []
        self.seconds = 0.0

    def add(self, renders: DesignRenders, seeds: int) -> None:
        """Take in the renders of one batch; replicates lie seed by seed."""
        self.pressed += np.split(renders.replicates, seeds)
        self.untouched += np.split(renders.background, seeds)
        self.seconds += renders.seconds

    def verdict(self) -> Verdict:
        """Return scores and differences by all renders so far."""
        pressed, untouched = self.pressed, self.untouched
        if len(pressed) >= MANY_SEEDS:
            pressed, untouched = (
                [one.mean(axis=0, keepdims=True) for one in parts] for parts in (pressed, untouched)
            )
        renders = DesignRenders(
            self.designs, np.concatenate(pressed), np.concatenate(untouched), self.seconds
        )
        measured = tuple(
            measure(self.scale, renders.replicates[:, i], design.power)
            for i, design in enumerate(self.designs)
        )
        return Verdict(self.names, measured, renders, self.scale)


def choose_winner(verdict: Verdict) -> str:
    """Return the key of the design that is handed over.

    The winner of the rounds, unless fresh renders show that another finalist is better by more
    than the error bars.
    """
    chosen = "winner"
    for name in verdict.names:
        if name != chosen and verdict.gain(chosen, name).interval()[0] > 0:
            chosen = name
    return chosen


def _amount(
    context: RunContext, designs: Sequence[Design], cost: CostModel | None
) -> dict[str, int]:
    """Return samples per cell and seed, and the seeds of a batch."""

    def choose() -> dict[str, int]:
        if context.fixed is not None:
            return {"samples": context.fixed.final, "seeds": 1}
        assert cost is not None  # with hours it is measured
        phi, _ = distinct_directions(designs)
        jobs = 2 * len(context.bends)
        seeds = -(-2 * cost.workers // jobs) if cost.workers > jobs else 1
        unit = pad_jobs(context.scene, phi, context.bends, samples=64, seeds=list(range(seeds)))
        free = (context.seconds_left - REPORT_SECONDS) / MIN_BATCHES
        least = MIN_SHARE * (context.until - context.began)
        seconds = max(least, min(2 * cost.fixed * jobs, free))
        return {"samples": cost.samples(unit, 64, seconds), "seeds": seeds}

    found: dict[str, int] = context.decide("final", choose)
    return found


def _rate(context: RunContext, verdict: Verdict) -> None:
    name = choose_winner(verdict)
    low, high = verdict.of(name).score.interval()
    context.keep_best("reference", verdict.of(name).score.value, (high - low) / 2, name)
