"""What the stages of a run share: the sensor, the record, who renders, and how much work there is.

A stage is made of steps. What a step does is a decision, logged before it is acted on, and its
renders are kept one by one: a run that goes on takes the same steps, and passes through those that
are finished within moments.

The work is fixed by a number of samples, or fitted to hours as they pass. Of the hours, shares go
to the transport table, the fit of the surrogate, and the rounds of the verification loop; the final
verification takes one batch of seeds after the other until the rest is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from optimize.design import Array, Design
from optimize.objectives import ObjectiveName
from optimize.overnight.run_log import RunLog
from optimize.overnight.store import Store
from optimize.overnight.workers import OutOfTime, StoredRenders
from render.levels import REFERENCE
from render.progress import Progress
from render.reference import RenderCost, RenderJob
from render.scene import Palette, Scene
from surrogate.runtime import Checker

TABLE_UNTIL, MODEL_UNTIL, LOOP_UNTIL = 0.40, 0.52, 0.76
"""Shares of the time by whose end these stages have finished."""
OVERTIME_SHARE = 0.04
"""What is still rendering when so much more of the time is over is given up for the next stage."""
REPORT_SECONDS = 8.0
"""What the end of a night takes: measuring finalists and writing files and report."""
FIT_STEPS = (200, 10_000)
"""Fewest and most steps of the networks."""
MIN_SAMPLES, UNIT_SAMPLES = 4, 64
MIN_SHARE = 0.02
"""Part of the time that a round, or a batch of the final verification, gets at least, even where
the stages before have used it up: with fewer paths its answer would be noise."""
TIME_USED = "its share of the time is used"


def fixed_amounts(samples: int) -> dict[str, dict[str, int]]:
    """Return the work of every stage that follows from ``samples`` of the table per cell.

    The networks take all of their steps from 2000 samples.
    """
    passes = math.ceil(samples / 512)
    low, high = FIT_STEPS
    return {
        "table": {"passes": passes, "samples": math.ceil(samples / passes)},
        "fit": {"steps": min(high, max(low, 5 * samples))},
        "rounds": {"samples": max(MIN_SAMPLES, samples // 32), "rounds": 3, "seeds": 1},
        "final": {"samples": max(MIN_SAMPLES, samples // 16), "batches": 4, "seeds": 1},
    }


def samples_within(cost: RenderCost, unit: Sequence[RenderJob], seconds: float) -> int:
    """Return the samples per cell that take ``seconds``; ``unit`` are jobs of `UNIT_SAMPLES`."""
    together = seconds * min(cost.workers, len(unit))
    renders = [job.samples / UNIT_SAMPLES for job in unit]
    return cost.samples_within(together, renders, MIN_SAMPLES)


@dataclass
class RunContext:
    """One working period: a run is one, and asked for more hours, it is extended or has another.

    Arguments:
        store, renders, log: record, runner and display.
        number: from 1; part of the names of decisions and of all seeds.
        extension: how often it was at its end and went on verifying.
        objective: what decides between designs.
        samples: of the table per cell, which fix all amounts of work; None where hours do.
        until: seconds of work (``Store.spent``) by which it ends, infinite with ``samples``.
        began: seconds of work before the period.
        cost: of renders, as far as it is known; None with ``samples``.
    """

    scene: Scene
    store: Store
    renders: StoredRenders
    log: RunLog
    seed: int
    objective: ObjectiveName
    number: int
    extension: int
    samples: int | None
    until: float
    began: float
    cost: RenderCost | None = None
    best: dict[str, Any] | None = None

    @property
    def bends(self) -> Array:
        """The scene's bends in rad, or the numbers of its states."""
        return np.array(self.scene.state_axis)

    @property
    def least_seconds(self) -> float:
        """Seconds that a round, or a batch of the final verification, gets at least."""
        return MIN_SHARE * (self.until - self.began)

    def seconds_until(self, fraction: float) -> float:
        """Return the seconds until ``fraction`` of the period is over."""
        return self.deadline(fraction) - self.store.spent()

    def deadline(self, fraction: float) -> float:
        """Return the seconds of work by which ``fraction`` of the period is over."""
        return self.began + fraction * (self.until - self.began)

    def decide(self, name: str, make: Callable[[], Any]) -> Any:
        """Return the period's decision of that name; see ``Store.decide``."""
        return self.store.decide(f"{self.number}/{name}", make)

    def decided(self, name: str) -> Any:
        """Return the decision, None where there is none yet."""
        return self.store.decided(f"{self.number}/{name}")

    def amount(self, stage: str, affordable: Callable[[RenderCost], dict[str, int]]) -> Any:
        """Return how much ``stage`` does, a decision: fixed, or what its time affords."""

        def choose() -> dict[str, int]:
            if self.samples is not None:
                return fixed_amounts(self.samples)[stage]
            assert self.cost is not None  # with hours it is measured before all other stages
            return affordable(self.cost)

        return self.decide(f"{stage} amount", choose)

    def steps(
        self,
        name: str,
        plan: Callable[[int, float], dict[str, Any]],
        work: Callable[[int, dict[str, Any]], None],
        late: float,
        first: int = 1,
    ) -> str:
        """Take one step after the other; return why there is no further one.

        Arguments:
            name: of the decisions; the number of the step follows it.
            plan: returns what step ``number`` renders (JSON), or ``{"stop": reason}``, given the
                longest seconds of a step so far.
            work: renders it and takes it in.
            late: seconds of work at which a step that still renders is given up, but for step 1.
            first: number of the first step.
        """
        number, longest = first, 0.0
        while True:
            began, given_up = self.store.spent(), f"{name} {number} given up"
            decided = self.decide(f"{name} {number}", partial(plan, number, longest))
            if "stop" in decided:
                return str(decided["stop"])
            try:
                if self.decided(given_up) is None:
                    with self.renders.until(late if number > 1 else None):
                        work(number, decided)
            except OutOfTime:
                self.decide(given_up, lambda: True)
            if self.decided(given_up) is not None:
                return TIME_USED
            longest = max(longest, self.store.spent() - began)
            number += 1

    def random_seed(self, purpose: int, index: int) -> int:
        """Return a seed of renders that no other purpose, index, period or run seed has."""
        words = np.random.SeedSequence([self.seed, self.number, purpose, index]).generate_state(1)
        return int(words[0] >> 1)

    def stage(self, name: str, kind: str) -> None:
        """Begin a stage: what the person sees, and what its renders are logged as."""
        self.log.stage(name)
        self.renders.kind = f"{self.number}/{kind}"

    def progress(self, state: Progress) -> None:
        """Show how far a stage is; with hours, the time left is theirs."""
        self.store.beat()
        left = state.eta_seconds if self.samples else max(self.seconds_until(1.0), 0.0)
        self.log.progress(replace(state, eta_seconds=left))

    def keep_best(
        self,
        value: float,
        interval: tuple[float, float] | None,
        what: str,
        by: Checker | None = None,
    ) -> None:
        """Keep the best design so far for ``tactilux status``; ``by`` None are renders.

        ``value`` and ``interval`` are the objective's, in counts or in degrees; without an
        interval nobody knows it.
        """
        level, effort = (REFERENCE, None) if by is None else (by.level, by.effort)
        self.best = {"objective": self.objective, "value": value}
        self.best["interval"] = None if interval is None else list(interval)
        self.best |= {"level": level, "effort": effort, "design": what}


def design_of(content: dict[str, Any]) -> Design:
    """Return the design that a decision holds, to the bit."""
    lists = content["palette"]
    response = tuple(map(tuple, lists["response"]))
    names, channels, inks = (tuple(lists[name]) for name in ("names", "channels", "inks"))
    palette = Palette(names, response, channels, inks, lists.get("shots", 1))
    return Design(np.array(content["phi"]), np.array(content["drive"]), palette)
