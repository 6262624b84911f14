"""What the stages of a night share: the sensor, the record, who renders, and the time there is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from optimize.design.design import Array, Design
from optimize.overnight.budget import FixedBudget
from optimize.overnight.run_log import RunLog
from optimize.overnight.runner import StoredRenders
from optimize.overnight.store import Store
from render.progress import Progress
from render.scene.schema import Scene


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

    def seconds_until(self, share: float) -> float:
        """Return the seconds until ``share`` of the period is over."""
        return self.began + share * (self.until - self.began) - self.store.spent()

    def deadline(self, share: float) -> float | None:
        """Return the seconds of work after which ``share`` of the period is over; None if fixed."""
        if self.fixed is not None:
            return None
        return self.began + share * (self.until - self.began)

    def decide(self, name: str, make: Callable[[], Any]) -> Any:
        """Return the period's decision of that name; see ``Store.decide``."""
        return self.store.decide(f"{self.number}/{name}", make)

    def decided(self, name: str) -> Any:
        """Return the decision, None where there is none yet."""
        return self.store.decided(f"{self.number}/{name}")

    def random_seed(self, purpose: int, index: int) -> int:
        """Return a seed of renders that no other purpose, index, period or run seed has."""
        words = np.random.SeedSequence([self.seed, self.number, purpose, index]).generate_state(1)
        return int(words[0] >> 1)

    def stage(self, name: str, kind: str) -> None:
        """Begin a stage: what the person sees, and what its renders are logged as."""
        self.log.stage(name)
        self.renders.kind = f"{self.number}/{kind}"

    def progress(self, state: Progress) -> None:
        """Show how far the renders of a stage are."""
        self.show(state.done, state.total, state.eta_seconds)

    def show(self, done: float, total: float, eta: float | None = None) -> None:
        """Show how far a stage is; with hours, the time left is theirs."""
        self.store.beat()
        self.log.progress(done, total, max(self.seconds_left, 0.0) if self.fixed is None else eta)

    def keep_best(self, level: str, score: float, reach: float, what: str) -> None:
        """Keep the best design so far for ``tactilux status``."""
        self.best = {"score": score, "interval": [score - reach, score + reach],
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
