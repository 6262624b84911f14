"""Fits within a given time: how many steps of the networks it buys, and what the rest takes.

Networks are most of a fit, and the number of their steps is free; ridge, held-out designs and
export are not. Seconds of a step are measured, before the fit by a trial on rows of the same size
and then by the fit itself. What the rest takes is told in steps, by which a slower machine, or one
that others use as well, is slower in everything.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from render.files import read_json, write_json
from render.reference import TimeBudget
from render.scene import Scene
from surrogate.training.mlp import NetworkConfig, seconds_per_step

MIN_STEPS = 100
"""Steps of the networks, however little time there is."""
RIDGE_STEPS, RIDGE_STEPS_PER_ROW, EXPORT_STEPS = 600, 0.1, 2400
"""What ridge (and per row of the data) and held-out designs with export take, in steps of the
networks: measured on ``finger20`` and on a sensor a tenth its size, by the processor's time."""
SPLIT_COST = 0.3
"""Cost of the networks of a split over that of the networks: half the steps, fewer members."""
MAX_FRACTION = 0.3
"""Part of the time that a fit may take from the renders, unless its fewest steps take more."""
TRIAL_EVERY = 0.2
"""Part of the time after which a step is timed anew: others may have come to use the machine."""


class FitTime:
    """The time of a fit that follows renders, within the budget of both.

    Arguments:
        budget: of renders and fit together.
        kept: the file of the numbers of steps, so that a fit that is done again has the same.
        request: what they were chosen for; other numbers are chosen anew.
        scene: the sensor.
        cells: directions times bends that are rendered.
        members: of the ensemble; network: its configuration, of the most steps.
    """

    def __init__(
        self,
        budget: TimeBudget,
        kept: Path,
        request: dict[str, Any],
        *,
        scene: Scene,
        directions: int,
        bends: int,
        members: int,
        network: NetworkConfig,
    ) -> None:
        """Choose nothing yet."""
        self.budget, self.kept, self.request = budget, kept, request
        self.members, self.network = members, network
        self.size = directions, scene.indenter.faces + 1
        self.rows = directions * bends * scene.fibers.count * scene.sites.count
        self.splits = 2 + (bends > 2)
        self.per_step = 0.0
        self._measured: float | None = None

    def reserve(self) -> float:
        """Return the seconds that the fit should be left: all its steps, or what may be had."""
        spent = self.budget.spent()
        if self._measured is None or spent - self._measured > TRIAL_EVERY * self.budget.seconds:
            self.per_step = seconds_per_step(*self.size, self.members, self.network)
            self._measured = self.budget.spent()
        fits = 1.0 + SPLIT_COST * self.splits
        rest = RIDGE_STEPS + RIDGE_STEPS_PER_ROW * self.rows + EXPORT_STEPS
        least, most = (
            self.per_step * (rest + fits * steps) for steps in (MIN_STEPS, self.network.steps)
        )
        return min(most, max(least, MAX_FRACTION * self.budget.seconds))

    def steps(self, name: str, most: int, *, members: int, splits: int) -> int:
        """Return the steps of the networks ``name`` that leave time for what follows.

        Arguments:
            name: of the fit.
            most: steps.
            members: of its ensemble.
            splits: fits of splits that follow.
        """
        stored = read_json(self.kept)
        known = stored.get("steps", {}) if stored.get("request") == self.request else {}
        if name not in known:
            free = self.budget.left() - EXPORT_STEPS * self.per_step
            each = self.per_step * members / self.members
            part = each + splits * (SPLIT_COST * self.per_step if name == "networks" else each)
            known[name] = min(most, max(MIN_STEPS, int(free / part)))
            write_json(self.kept, {"request": self.request, "steps": known})
        return int(known[name])

    def took(self, steps: int, members: int, seconds: float) -> None:
        """Learn the seconds of a step from a fit that is done."""
        self.per_step = seconds / steps * self.members / members
