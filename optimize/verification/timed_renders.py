"""The renders of a loop within a given time: what every round and the finalists may take.

A round gets its part of the time that is left, after the searches that are still to come, as long
as the last one took. A loop that ends early leaves its time to the finalists.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from optimize.design import Design
from optimize.verification.design_renders import (
    DesignRenders,
    distinct_directions,
    reference_renders,
)
from optimize.verification.finalists import FINALISTS
from optimize.verification.score_allocation import allocation_digest
from render.progress import OnProgress, Progress, in_stage
from render.reference import (
    EVERYTHING,
    SampleAllocation,
    TimeBudget,
    render_within,
    samples_per_pass,
    stored_plan,
    transport_jobs,
)
from render.scene import Scene

FINALISTS_WEIGHT = 2.0
"""Time of the finalists' renders, in units of that of a round."""
REPORT_SECONDS, REPORT_FRACTION = 5.0, 0.05
"""What scores, pictures and the report take at the end: seconds, and a part of the time."""


@dataclass(frozen=True)
class TimedPlan:
    """What fitted into the time of one call; kept beside its renders.

    Arguments:
        scene_hash, minutes: whose, and what was asked for.
        designs: digest of the directions; allocation: of where the samples go; seeds: theirs.
        samples, per_pass: per cell and seed, and of those in one pass (``transport_jobs``).
    """

    scene_hash: str
    minutes: float
    designs: str
    allocation: str
    seeds: list[int]
    samples: int
    per_pass: int


class TimedRenders:
    """Renders designs like ``reference_renders``, with the samples that time allows.

    Arguments of the constructor:
        scene: the sensor.
        budget: of everything.
        rounds: calls before that of the finalists, at most.
        checkpoint: folder of renders and plans; asked for the same again, it renders nothing.
        progress: called every few seconds.
    """

    def __init__(
        self,
        scene: Scene,
        budget: TimeBudget,
        *,
        rounds: int,
        checkpoint: Path,
        progress: OnProgress | None = None,
    ) -> None:
        """Render nothing yet."""
        self.scene, self.budget, self.rounds = scene, budget, rounds
        self.checkpoint, self.progress = checkpoint, progress
        self._ended = budget.spent()
        self._noted = False

    def __call__(
        self,
        designs: Sequence[Design],
        *,
        samples: int,  # noqa: ARG002 - all `RenderDesigns` take it
        seeds: Sequence[int],
        title: str,
        allocation: SampleAllocation = EVERYTHING,
    ) -> DesignRenders:
        """Return the renders; ``samples`` are not asked for."""
        end = self._end(title)
        phi, _ = distinct_directions(designs)
        bends = np.array(self.scene.state_axis)
        wanted: dict[str, Any] = {
            "scene_hash": self.scene.hash,
            "minutes": self.budget.seconds / 60.0,
            "designs": hashlib.sha256(phi.tobytes()).hexdigest(),
            "allocation": allocation_digest(allocation),
            "seeds": list(seeds),
        }
        pads = (1 + allocation.untouched) * len(bends)

        def make() -> TimedPlan:
            each = samples_per_pass(self.scene, end - self.budget.spent(), pads * len(seeds))
            jobs = transport_jobs(
                self.scene,
                phi,
                bends,
                samples=each,
                per_pass=each,
                seeds=seeds,
                allocation=allocation,
            )
            units = render_within(
                jobs,
                self.budget,
                self.checkpoint,
                reserve=lambda: self.budget.seconds - end,
                progress=in_stage(self._report, title),
            )
            return TimedPlan(samples=units * each, per_pass=each, **wanted)

        path = self.checkpoint / f"plan-{title.replace(' ', '-')}.json"
        plan = stored_plan(path, TimedPlan, wanted, make)
        render = reference_renders(
            self.scene, self.checkpoint, self.progress, per_pass=plan.per_pass
        )
        found = render(
            designs, samples=plan.samples, seeds=seeds, title=title, allocation=allocation
        )
        self._ended = self.budget.spent()
        return found

    def _report(self, at: Progress) -> None:
        """Tell how far it is, and once that the time is too short."""
        if self.progress is not None:
            self.progress(replace(at, note="") if self._noted else at)
        self._noted |= bool(at.note)

    def _end(self, title: str) -> float:
        """Return the seconds of the budget at which this call's part of the time ends."""
        spent = self.budget.spent()
        search, free = spent - self._ended, self.budget.left()
        free -= REPORT_SECONDS + REPORT_FRACTION * self.budget.seconds
        parts = 1.0
        if title != FINALISTS:
            self.rounds -= 1
            free -= search * max(self.rounds, 0)
            parts += max(self.rounds, 0) + FINALISTS_WEIGHT
        return spent + max(free, 0.0) / parts
