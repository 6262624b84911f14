"""What the stages of a run share: the sensor, the record, who renders, and how much work there is.

The work is fixed by a number of samples, or fitted to hours as they pass. Of the hours, shares go
to the transport table, the fit of the surrogate, and the rounds of the verification loop; the final
verification takes one batch of seeds after the other until the rest is used. Every choice that
depends on a clock is logged as a decision before it is acted on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from optimize.design import Array, Design
from optimize.overnight.run_log import RunLog
from optimize.overnight.store import Store
from optimize.overnight.workers import OutOfTime, StoredRenders
from render.progress import Progress
from render.reference import RenderCost, RenderJob
from render.scene import Scene

T = TypeVar("T")
TABLE_UNTIL, MODEL_UNTIL, LOOP_UNTIL = 0.40, 0.52, 0.76
"""Shares of the time by whose end these stages have finished."""
OVERTIME_SHARE = 0.04
"""What is still rendering when so much more of the time is over is given up for the next stage."""
REPORT_SECONDS = 8.0
"""What the end of a night takes: measuring finalists and writing files and report."""
JOB_SECONDS = 90.0
"""A render of the table lasts about so long: what a worker that dies can lose."""
MIN_PASSES = 3
"""A table is rendered in so many passes at least, so that a slow machine can do with fewer."""
MAX_ROUNDS, FIXED_ROUNDS = 12, 3
FIXED_SEEDS = 4
FIT_STEPS = (200, 10_000)
"""Fewest and most steps of the networks."""
MIN_SAMPLES = 4
MIN_SHARE = 0.02
"""Part of the time that a round, or a batch of the final verification, gets at least, even where
the stages before have used it up: with fewer paths its answer would be noise."""


def samples_within(cost: RenderCost, unit: Sequence[RenderJob], per: int, seconds: float) -> int:
    """Return the samples per cell whose jobs take ``seconds``.

    Arguments:
        cost: of a job and of its samples.
        unit: the jobs of ``per`` samples per cell.
        per: that number.
        seconds: of all workers together.
    """
    together = seconds * min(cost.workers, len(unit))
    return cost.samples_within(together, [job.samples / per for job in unit], MIN_SAMPLES)


@dataclass(frozen=True)
class FixedBudget:
    """Amounts that follow from ``samples`` of the transport table per cell."""

    samples: int

    @property
    def passes(self) -> int:
        """Passes of the table."""
        return max(1, math.ceil(self.samples / 512))

    @property
    def per_pass(self) -> int:
        """Samples per cell and pass."""
        return math.ceil(self.samples / self.passes)

    @property
    def fit_steps(self) -> int:
        """Steps of the networks; all of them from 2000 samples."""
        low, high = FIT_STEPS
        return min(high, max(low, 5 * self.samples))

    @property
    def round(self) -> int:
        """Samples per cell of a round."""
        return max(MIN_SAMPLES, self.samples // 32)

    @property
    def final(self) -> int:
        """Samples per cell and seed of the final verification."""
        return max(MIN_SAMPLES, self.samples // 16)


@dataclass
class RunContext:
    """One working period: a run is one, and asked for more hours, it is extended or has another.

    Arguments:
        scene: the sensor.
        store, renders, log: record, runner and display.
        seed: of the run.
        number: from 1; part of the names of decisions and of all seeds.
        extension: how often it was at its end and went on verifying.
        fixed: amounts of work; None where hours decide.
        until: seconds of work (``Store.spent``) by which the period ends, infinite with ``fixed``.
        began: seconds of work before the period.
    """

    scene: Scene
    store: Store
    renders: StoredRenders
    log: RunLog
    seed: int
    number: int
    extension: int
    fixed: FixedBudget | None
    until: float
    began: float
    best: dict[str, Any] | None = field(default=None)

    @property
    def bends(self) -> Array:
        """The scene's bends in rad."""
        return np.array(self.scene.bending.angles)

    @property
    def seconds_left(self) -> float:
        """Seconds until the period ends."""
        return self.until - self.store.spent()

    def seconds_until(self, fraction: float) -> float:
        """Return the seconds until ``fraction`` of the period is over."""
        return self.began + fraction * (self.until - self.began) - self.store.spent()

    def deadline(self, fraction: float) -> float | None:
        """Return the seconds of work by which ``fraction`` of the period is over; None if fixed."""
        if self.fixed is not None:
            return None
        return self.began + fraction * (self.until - self.began)

    def decide(self, name: str, make: Callable[[], Any]) -> Any:
        """Return the period's decision of that name; see ``Store.decide``."""
        return self.store.decide(f"{self.number}/{name}", make)

    def decided(self, name: str) -> Any:
        """Return the decision, None where there is none yet."""
        return self.store.decided(f"{self.number}/{name}")

    def within(
        self, name: str, deadline: float | None, work: Callable[[], T], given_up: Any = True
    ) -> T | None:
        """Return what ``work`` renders until ``deadline``, in seconds of ``Store.spent``.

        None where the time was over: that is a decision, with ``given_up`` as its value, which a
        run that goes on takes again.
        """
        name = f"{name} given up"
        if self.decided(name) is None:
            try:
                with self.renders.until(deadline):
                    return work()
            except OutOfTime:
                self.decide(name, lambda: given_up)
        return None

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
        left = max(self.seconds_left, 0.0) if self.fixed is None else state.eta_seconds
        self.log.progress(replace(state, eta_seconds=left))

    def keep_best(self, level: str, score: float, half_width: float, what: str) -> None:
        """Keep the best design so far for ``tactilux status``."""
        self.best = {"score": score, "interval": [score - half_width, score + half_width],
                     "level": level, "design": what}  # fmt: skip


def extended(name: str, extension: int) -> str:
    """Return the name that a decision has in a period's extension."""
    return f"{name}, extension {extension}" if extension else name


def design_json(design: Design) -> dict[str, Any]:
    """Return a design as JSON keeps it, to the bit."""
    return {"phi": design.phi.tolist(), "power": design.power.tolist()}


def design_of(content: dict[str, Any]) -> Design:
    """Return the design that ``design_json`` wrote."""
    return Design(np.array(content["phi"]), np.array(content["power"]))
