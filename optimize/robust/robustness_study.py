"""What tolerances and shadows do to the designs of an exploration, and a design made for them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import IO

import numpy as np

from optimize.design import limits_of
from optimize.exploration import Exploration, rate
from optimize.robust.material_slopes import material_slopes, tolerances_of
from optimize.robust.perturbed_sensors import (
    Measure,
    PerturbedSensors,
    RobustRating,
    RobustScore,
    rate_robustly,
)
from optimize.robust.sensitivity import Sensitivity, sensitivities
from optimize.robust.shadow import ShadowPenalty
from optimize.scoring import TableScorer, search_table
from optimize.search import NominalScore, Objective, WeightedSum, multi_start
from optimize.search.colors import quick_colors, renamed_like
from optimize.ui.console import print_table
from render.progress import Clock, OnProgress, in_stage
from render.scene import Spread

SEARCH_DRAWS, RATING_DRAWS = 48, 1000
COLORINGS = 6
"""Best colorings of the nominal search that get directions of their own."""
UNITS = {"fiber_angle": ("deg", 180.0 / math.pi), "diffuser_thickness": ("mm", 1.0)}
"""Of tolerances in tables, with their number per rad or mm; the others are relative, in %."""


@dataclass(frozen=True, eq=False)
class RobustnessStudy:
    """Ratings of all stages beyond their nominal score.

    Arguments:
        measure: what the robust search maximized; None without one.
        robust: by stage key, over sensors that the search did not see.
        shadows: by stage key, the penalty in counts; shadow_weight: of it in the search.
        sensitivities: of the last stage, the dearest tolerance first.
        at_end: fraction of directions that errors turned beyond 0 to 180 deg in the last stage.
    """

    measure: Measure | None
    robust: dict[str, RobustRating]
    shadows: dict[str, float]
    shadow_weight: float | None
    sensitivities: tuple[Sensitivity, ...]
    at_end: float

    def to_json(self) -> dict[str, object]:
        """Return plain data."""
        return {
            "measure": self.measure,
            "robust": {key: rating.to_json() for key, rating in self.robust.items()},
            "shadow_weight": self.shadow_weight,
            "shadow_penalty": self.shadows,
            "sensitivities": [entry.to_json() for entry in self.sensitivities],
            "directions_at_end": self.at_end,
        }

    def facts(self, titles: Mapping[str, str]) -> list[tuple[str, str]]:
        """Return lines of the report; ``titles`` names the stages by key."""
        lines = []
        if self.robust:
            lows = [f"{titles[key]} {rating.low:.1f}" for key, rating in self.robust.items()]
            draws = next(iter(self.robust.values())).draws
            lines.append((f"Lower 10 % of S on {draws} sensors as built", ", ".join(lows)))
            costs = [f"{entry.name} {entry.low_loss:.1f}" for entry in self.sensitivities]
            lines.append(("Loss at that quantile, by tolerance alone", ", ".join(costs)))
        if self.shadows:
            losses = [f"{titles[key]} {value:.1f}" for key, value in self.shadows.items()]
            lines.append(("Counts that a bolt's shadows take", ", ".join(losses)))
        return lines


def study_robustness(
    exploration: Exploration,
    measure: Measure | None,
    shadow_weight: float | None,
    report: OnProgress,
) -> Exploration:
    """Return the exploration with one more stage, the design for tolerances or shadows.

    ``measure`` None leaves tolerances out, ``shadow_weight`` None the penalty for shadows.
    """
    scene, checker, seed = exploration.scene, exploration.checker, exploration.seed
    table = search_table(checker)
    scorer = TableScorer(table, limits=limits_of(scene))
    goal: Objective = NominalScore(scorer)
    shadow = None if shadow_weight is None else ShadowPenalty(scene, table)
    spreads: Mapping[str, Spread] = {}
    if measure is not None:
        spreads = tolerances_of(scene)
        stage_report = in_stage(report, "previews of other materials")
        slopes = material_slopes(scene, spreads, table.phi, stage_report)
        # Sensors to search on, and others that rate what was found.
        seen, unseen = (
            PerturbedSensors(scorer, spreads, slopes, draws=draws, seed=1000 * seed + stream)
            for stream, draws in ((1, SEARCH_DRAWS), (2, RATING_DRAWS))
        )
        goal = RobustScore(seen, measure)
    if shadow is not None and shadow_weight is not None:
        goal = WeightedSum((1.0, goal), (shadow_weight, shadow))
    best = exploration.stages[-1].design
    top = quick_colors(scorer, best.phi, starts=[best.colors], seed=seed).top
    colorings = [np.array(row) for row, _ in top[:COLORINGS]]
    if scorer.colors_alike:
        names = len(scorer.palette.names)
        colorings = [renamed_like(row, best.colors, names) for row in colorings]
    starts = [best, *(scorer.design(best.phi, row) for row in colorings)]
    design = multi_start(scorer, goal, starts, in_stage(report, "refining")).design
    titles = [title for title, used in (("Robust", measure), ("Shadow-aware", shadow)) if used]
    stage = rate(
        checker, scene, "refined", " and ".join(titles).capitalize(), "the refinement", design
    )
    stages = (*exploration.stages, stage)
    ratings: dict[str, RobustRating] = {}
    costs: tuple[Sensitivity, ...] = ()
    at_end = 0.0
    if measure is not None:
        clock = Clock(len(stages) + 1, report, "rating")
        for entry in stages:
            ratings[entry.key] = rate_robustly(scorer, unseen, entry.design)
            clock.tick()
        costs = tuple(sensitivities(scorer, design, spreads, slopes, seed=seed))
        clock.tick()
        at_end = unseen.fraction_at_end(design.phi)
    shadows = {} if shadow is None else {e.key: -shadow.value(e.design) for e in stages}
    extra = RobustnessStudy(measure, ratings, shadows, shadow_weight, costs, at_end)
    return replace(exploration, stages=stages, study=extra)


def print_study(stream: IO[str], study: RobustnessStudy, titles: Mapping[str, str]) -> None:
    """Write the tables to ``stream``; ``titles`` names the stages by key."""
    if study.robust:
        draws = next(iter(study.robust.values())).draws
        print_table(
            stream,
            f"On {draws} sensors as built",
            ("design", "S as drawn", "mean S", "deviation", "lower 10 %", "95% interval of it"),
            [
                (
                    titles[key],
                    f"{rating.nominal:.1f}",
                    f"{rating.mean:.1f}",
                    f"{rating.deviation:.1f}",
                    f"{rating.low:.1f}",
                    "{:.1f} to {:.1f}".format(*rating.low_interval),
                )
                for key, rating in study.robust.items()
            ],
        )
    if study.sensitivities:
        print_sensitivities(stream, study.sensitivities)
    if study.at_end:
        stream.write(
            f"{study.at_end:.1%} of the turned fibers would leave 0 to 180 deg and stay there.\n"
        )
    for key, penalty in study.shadows.items():
        stream.write(f"{titles[key]}: a bolt's shadows take {penalty:.1f} counts.\n")


def print_sensitivities(stream: IO[str], sensitivities: Sequence[Sensitivity]) -> None:
    """Write the sensitivity table, the dearest tolerance first."""
    rows = []
    for entry in sensitivities:
        unit, factor = UNITS.get(entry.name, ("%", 100.0))
        steepest = entry.slope[abs(entry.slope).argmax()] / factor
        rows.append(
            (
                entry.name,
                f"{entry.sigma * factor:.3g} {unit}",
                f"{steepest:+.3g} / {unit}",
                f"{entry.deviation:.2f}",
                f"{entry.mean_loss:.2f}",
                f"{entry.low_loss:.2f} ± {entry.low_loss_se:.2f}",
                "" if entry.worst_fiber is None else str(entry.worst_fiber),
            )
        )
    headings = ("sigma", "slope of S", "spread of S", "mean loss", "loss at low 10 %", "fiber")
    title = "What each tolerance alone costs, in counts"
    print_table(stream, title, ("tolerance", *headings), rows)
