"""The final verification: finalists rendered together, with seeds that had no part in choosing.

One batch of seeds after the other until the time is used; their replicates are pooled.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from optimize.design.design import Array, Design
from optimize.overnight.amounts import LEAST_SHARE, REPORT_SECONDS, SEEDS_FIXED, Pace
from optimize.overnight.loop_stage import Outcome
from optimize.overnight.runner import OutOfTime
from optimize.overnight.search_stage import baseline_of
from optimize.overnight.shift import Shift, design_json, design_of, extended
from optimize.scoring.measure import measure
from optimize.scoring.score_scale import Scale
from optimize.verification.renders import DesignRenders, distinct_directions, reference_renders
from optimize.verification.verdict import Verdict
from render.reference.transport import pad_jobs

FINAL_PURPOSE = 3
LEAST_BATCHES = 3
MANY_SEEDS = 16
"""From so many seeds on, the mean of each is one replicate."""
TITLES = {
    "baseline": "Baseline",
    "colors": "Colors",
    "thesis": "Thesis-style design",
    "winner": "Winner",
    "runner-up": "Runner-up",
}


def chosen_finalists(
    shift: Shift, colored: Design, thesis: Design | None, outcome: Outcome
) -> list[tuple[str, Design]]:
    """Return who is verified, by key."""

    def choose() -> list[dict[str, Any]]:
        found = [("baseline", baseline_of(shift)), ("colors", colored)]
        found += [("thesis", thesis)] if thesis is not None else []
        best = [entry.design for entry in outcome.contenders[:2]]
        found += list(zip(("winner", "runner-up"), best, strict=False))
        return [{"key": key, "design": design_json(design)} for key, design in found]

    kept = shift.decide("finalists", choose)
    return [(entry["key"], design_of(entry["design"])) for entry in kept]


def verify_finalists(
    shift: Shift, finalists: Sequence[tuple[str, Design]], scale: Scale, pace: Pace | None
) -> tuple[Verdict, list[tuple[int, Verdict]]]:
    """Return the verdict of all seeds, and those of the first 1, 2, 4, ... seeds.

    The finalists were chosen before the first of these seeds, so those of extensions are pooled.

    Arguments:
        shift: the shift.
        finalists: designs by key, the baseline first.
        scale: of the scores.
        pace: of renders; None for a fixed amount of work.
    """
    designs = [design for _, design in finalists]
    amount = _amount(shift, designs, pace)
    render = reference_renders(
        shift.scene, None, lambda _, state: shift.progress(state), runner=shift.renders
    )
    pooled = _Pool(finalists, scale)
    checks: list[tuple[int, Verdict]] = []
    longest, number, extension = 0.0, 0, 0
    while True:
        began = shift.store.spent()
        name = extended(f"final batch {number + 1}", extension)

        def another(number: int = number, longest: float = longest) -> list[int]:
            if shift.fixed is not None and number == SEEDS_FIXED:
                return []
            # The last batch may end as much too late as it would end too early without it.
            if number and longest / 2 > shift.left - REPORT_SECONDS:
                return []
            first = number * amount["seeds"]
            return [shift.random_seed(FINAL_PURPOSE, first + i) for i in range(amount["seeds"])]

        seeds = shift.decide(name, another)
        if not seeds or shift.decided(f"{name} given up") is not None:
            if extension == shift.extension:
                break
            extension += 1
            continue
        shift.stage("Final verification", "final")
        late = None if shift.fixed is not None or not number else shift.until - REPORT_SECONDS / 2
        try:
            with shift.renders.until(late):
                found = render(
                    designs, samples=amount["samples"], seeds=seeds, title="the finalists"
                )
        except OutOfTime:
            shift.decide(f"{name} given up", lambda: True)
            break
        pooled.add(found, len(seeds))
        number += 1
        longest = max(longest, shift.store.spent() - began)
        if number & (number - 1) == 0:
            checks.append((number, pooled.verdict()))
            _rate(shift, checks[-1][1])
    if checks[-1][0] != number:
        checks.append((number, pooled.verdict()))
    _rate(shift, checks[-1][1])
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


def handed_over(verdict: Verdict) -> str:
    """Return the key of the design that is handed over.

    The winner of the rounds, unless fresh renders show that another finalist is better by more
    than the error bars.
    """
    chosen = "winner"
    for name in verdict.names:
        if name != chosen and verdict.gain(chosen, name).interval()[0] > 0:
            chosen = name
    return chosen


def _amount(shift: Shift, designs: Sequence[Design], pace: Pace | None) -> dict[str, int]:
    """Return samples per cell and seed, and the seeds of a batch."""

    def choose() -> dict[str, int]:
        if shift.fixed is not None:
            return {"samples": shift.fixed.final, "seeds": 1}
        assert pace is not None  # with hours it is measured
        phi, _ = distinct_directions(designs)
        jobs = 2 * len(shift.bends)
        seeds = -(-2 * pace.workers // jobs) if pace.workers > jobs else 1
        unit = pad_jobs(shift.scene, phi, shift.bends, samples=64, seeds=list(range(seeds)))
        free = (shift.left - REPORT_SECONDS) / LEAST_BATCHES
        least = LEAST_SHARE * (shift.until - shift.began)
        seconds = max(least, min(2 * pace.fixed * jobs, free))
        return {"samples": pace.samples(unit, 64, seconds), "seeds": seeds}

    found: dict[str, int] = shift.decide("final", choose)
    return found


def _rate(shift: Shift, verdict: Verdict) -> None:
    name = handed_over(verdict)
    low, high = verdict.of(name).score.interval()
    shift.rated("reference", verdict.of(name).score.value, (high - low) / 2, name)
