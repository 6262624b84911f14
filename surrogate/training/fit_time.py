"""Fits within a given time: how many steps of the networks it buys, and what the rest takes.

Networks are most of a long fit, and the number of their steps is free; ridge, held-out designs and
export are not. Seconds of a step are measured, before the fit by a trial on rows of the same size
and then by the fit itself. What the rest takes is told in steps, by which a slower machine, or one
that others use as well, is slower in everything.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from render.files import read_json, write_json
from render.reference import TimeBudget
from surrogate.training.mlp import NetworkConfig, seconds_per_step
from surrogate.training.render_plan import RenderTime

MIN_STEPS = 100
"""Steps of the networks, however little time there is."""
PREVIEW_STEPS, STEPS_PER_DRAW = 200.0, 2.7
"""What the preview takes, in steps of the networks: in any case, and per fiber, direction and bend
that is drawn. These figures were measured by the processor's time on ``finger20``, on 12 lamps
around a rigid pad, and on 5 lamps and 2 sites."""
RENDER_STEPS, STEPS_PER_JOB = 1000.0, 350.0
"""What renders with the fewest samples take, with kernels that were compiled before: once, and per
job."""
RIDGE_STEPS, STEPS_PER_ROW = 100.0, 0.12
"""What ridge takes, in any case and per row of the data."""
EXPORT_STEPS, EXPORT_STEPS_PER_ROW = 120.0, 0.07
"""What held-out designs, calibration and export take after the networks."""
SPLIT_COST = 0.3
"""Cost of the networks of a split over that of the networks: half the steps, fewer members."""
MAX_FRACTION = 0.3
"""Part of the time that a fit may take from the renders, unless its fewest steps take more."""
TRIAL_EVERY = 0.2
"""Part of the time after which a step is timed anew: others may have come to use the machine."""


@dataclass(frozen=True)
class TrainingCost:
    """What the parts of a training take, in steps of its networks.

    Arguments:
        draws: fibers, directions, bends and materials that the preview draws.
        jobs: renders of a pad.
        directions: that are rendered; rows: fibers, directions, bends and sites.
        normals: of a cell.
        splits: fits to parts of the data.
        members: of the ensemble; network: its configuration, of the most steps.
    """

    draws: int
    jobs: int
    directions: int
    rows: int
    normals: int
    splits: int
    members: int
    network: NetworkConfig

    @property
    def preview(self) -> float:
        """Steps that the preview takes."""
        return PREVIEW_STEPS + STEPS_PER_DRAW * self.draws

    @property
    def export(self) -> float:
        """Steps of all that follows the networks."""
        return EXPORT_STEPS + EXPORT_STEPS_PER_ROW * self.rows

    @property
    def least(self) -> float:
        """Steps of a training with the fewest samples and steps."""
        return self.preview + RENDER_STEPS + STEPS_PER_JOB * self.jobs + self.fit(MIN_STEPS)

    def fit(self, steps: int) -> float:
        """Return the steps of a fit whose networks have ``steps``."""
        ridge = RIDGE_STEPS + STEPS_PER_ROW * self.rows
        return ridge + (1.0 + SPLIT_COST * self.splits) * steps + self.export

    def affordable(self, seconds: float, per_step: float, fewest: int) -> int:
        """Return the networks' steps, ``fewest`` or more, with which a fit takes ``seconds``."""
        free = seconds / per_step - self.fit(0)
        most = self.network.steps
        return min(most, max(fewest, int(free / (1.0 + SPLIT_COST * self.splits))))

    def per_step(self) -> float:
        """Return the seconds of a step here and now."""
        return seconds_per_step(self.directions, self.normals, self.members, self.network)


class FitTime:
    """The time of a fit that follows renders, within the budget of both.

    Arguments:
        budget: of renders and fit together.
        kept: the file of the numbers of steps, so that a fit that is done again has the same.
        request: what they were chosen for; other numbers are chosen anew.
        cost: of its parts.
    """

    def __init__(
        self, budget: TimeBudget, kept: Path, request: dict[str, Any], cost: TrainingCost
    ) -> None:
        """Choose nothing yet."""
        self.budget, self.kept, self.request, self.cost = budget, kept, request, cost
        self.per_step = 0.0
        self._measured: float | None = None

    def warning(self) -> str:
        """Return what to say before everything, where the time cannot be kept; else nothing."""
        least = self.per_step_now() * self.cost.least
        said = self.budget.warning(least)
        if said:
            self.budget = self.budget.announcing(least)
        return said

    def reserve(self) -> float:
        """Return the seconds that the fit should be left: all its steps, or what may be had."""
        per_step = self.per_step_now()
        least, most = (
            per_step * self.cost.fit(steps) for steps in (MIN_STEPS, self.cost.network.steps)
        )
        return min(most, max(least, MAX_FRACTION * self.budget.seconds))

    def without_networks(self, rendered: float) -> RenderTime:
        """Return the time that renders have once more, where no networks follow.

        ``rendered`` are the seconds of renders since the budget began, which count twice otherwise:
        renders that go on count what they took before.
        """
        return RenderTime(
            self.budget.charged(-rendered), lambda: self.per_step_now() * self.cost.fit(0)
        )

    def per_step_now(self) -> float:
        """Return the seconds of a step, measured not long ago."""
        spent = self.budget.spent()
        if self._measured is None or spent - self._measured > TRIAL_EVERY * self.budget.seconds:
            self.per_step = self.cost.per_step()
            self._measured = self.budget.spent()
        return self.per_step

    def steps(self, name: str, most: int, *, members: int, splits: int) -> int:
        """Return the steps of the networks ``name`` that leave time for what follows.

        They are ``most`` at most; the ensemble has ``members``, and ``splits`` fits of splits
        follow.
        """
        stored = read_json(self.kept)
        known = stored.get("steps", {}) if stored.get("request") == self.request else {}
        if name not in known:
            free = self.budget.left() - self.cost.export * self.per_step
            each = self.per_step * members / self.cost.members
            part = each + splits * (SPLIT_COST * self.per_step if name == "networks" else each)
            known[name] = min(most, max(MIN_STEPS, int(free / part)))
            write_json(self.kept, {"request": self.request, "steps": known})
        return int(known[name])

    def took(self, steps: int, members: int, seconds: float) -> None:
        """Learn the seconds of a step from a fit that is done."""
        self.per_step = seconds / steps * self.cost.members / members
