"""What tolerances and shadows do to the designs of an exploration, and a design made for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import IO

import numpy as np

from optimize.design import limits_of
from optimize.exploration import Exploration, rate
from optimize.objectives import ObjectiveName, title_of, unit_of
from optimize.readers import merit_of
from optimize.robust.material_slopes import material_slopes, tolerances_of
from optimize.robust.perturbed_sensors import (
    Measure,
    PerturbedSensors,
    RobustObjective,
    RobustRating,
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

RATING_DRAWS = 1000
SEARCH_DRAWS, COLORINGS, CLIMBS = 48, 6, 4
"""Sensors that a search for S sees, the best colorings of the nominal search that get directions of
their own, and how many of these climb."""
DEAR_DRAWS, DEAR_COLORINGS, DEAR_CLIMBS = 16, 2, 1
"""The same of a reader, whose degrees take 20 times as long: a minute on finger20."""
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
            first = next(iter(self.robust.values()))
            shown, title = figure_of(first.objective), title_of(first.objective)
            worst = [f"{titles[key]} {shown(one.tenth)}" for key, one in self.robust.items()]
            told = f"Worse than this is one in ten of {first.draws} sensors as built ({title})"
            lines.append((told, ", ".join(worst)))
            costs = [f"{entry.name} {shown(entry.low_loss)}" for entry in self.sensitivities]
            lines.append(("One in ten loses more, by tolerance alone", ", ".join(costs)))
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

    ``measure`` None leaves tolerances out, ``shadow_weight`` None the penalty for shadows, which
    is in counts of S. Tolerances are those of what the exploration improved; where one built sensor
    in ten reads worse than of the baseline, and that is allowed, the baseline is handed over.
    """
    scene, checker, seed = exploration.scene, exploration.checker, exploration.seed
    table = search_table(checker)
    scorer = TableScorer(table, limits=limits_of(scene))
    goal: Objective = NominalScore(scorer)
    dear = measure is not None and exploration.objective != "score"
    count, colorings, climbs = (
        (DEAR_DRAWS, DEAR_COLORINGS, DEAR_CLIMBS) if dear else (SEARCH_DRAWS, COLORINGS, CLIMBS)
    )
    shadow = None if shadow_weight is None else ShadowPenalty(scene, table)
    spreads: Mapping[str, Spread] = {}
    if measure is not None:
        spreads = tolerances_of(scene)
        stage_report = in_stage(report, "previews of other materials")
        slopes = material_slopes(scene, spreads, table.phi, stage_report)
        merit = merit_of(exploration.objective, scorer, scene)
        # Sensors to search on, and others that rate what was found.
        seen, unseen = (
            PerturbedSensors(merit, spreads, slopes, draws=draws, seed=1000 * seed + stream)
            for stream, draws in ((1, count), (2, RATING_DRAWS))
        )
        goal = RobustObjective(seen, measure)
    if shadow is not None and shadow_weight is not None:
        goal = WeightedSum((1.0, goal), (shadow_weight, shadow))
    best = exploration.stages[-1].design
    top = quick_colors(scorer, best.phi, starts=[best.colors], seed=seed).top
    rows = [np.array(row) for row, _ in top[:colorings]]
    if scorer.colors_alike:
        names = len(scorer.palette.names)
        rows = [renamed_like(row, best.colors, names) for row in rows]
    starts = [best, *(scorer.design(best.phi, row) for row in rows)]
    design = multi_start(scorer, goal, starts, in_stage(report, "refining"), climbs).design
    titles = [title for title, used in (("Robust", measure), ("Shadow-aware", shadow)) if used]
    stage = rate(
        checker, scene, "refined", " and ".join(titles).capitalize(), "the refinement", design
    )
    stages = [*exploration.stages, stage]
    ratings: dict[str, RobustRating] = {}
    costs: tuple[Sensitivity, ...] = ()
    at_end = 0.0
    if measure is not None:
        clock = Clock(len(stages) + 1, report, "rating")
        for entry in stages:
            ratings[entry.key] = rate_robustly(unseen, entry.design)
            clock.tick()
        first = exploration.stages[0]
        kept = bool(scorer.limits.fits(first.design.colors[None])[0])
        if kept and ratings[first.key].better(ratings[stage.key]):
            design, ratings[stage.key] = first.design, ratings[first.key]
            stages[-1] = replace(first, key=stage.key, title=stage.title, change=stage.change)
        costs = tuple(sensitivities(merit, design, spreads, slopes, seed=seed))
        clock.tick()
        at_end = unseen.fraction_at_end(design.phi)
    shadows = {} if shadow is None else {e.key: -shadow.value(e.design) for e in stages}
    extra = RobustnessStudy(measure, ratings, shadows, shadow_weight, costs, at_end)
    return replace(exploration, stages=tuple(stages), study=extra)


def figure_of(objective: ObjectiveName) -> Callable[[float], str]:
    """Return how figures of an objective are written: S in counts, errors in degrees."""
    digits = ".1f" if objective == "score" else ".2f"
    return lambda value: f"{value:{digits}}{unit_of(objective)}"


def print_study(stream: IO[str], study: RobustnessStudy, titles: Mapping[str, str]) -> None:
    """Write the tables to ``stream``; ``titles`` names the stages by key."""
    objective: ObjectiveName = "score"
    if study.robust:
        first = next(iter(study.robust.values()))
        objective = first.objective
        shown = figure_of(objective)
        print_table(
            stream,
            f"{title_of(objective)} on {first.draws} sensors as built",
            ("design", "as drawn", "mean", "deviation", "one in ten worse", "95% interval of it"),
            [
                (
                    titles[key],
                    *map(shown, (one.nominal, one.mean, one.deviation, one.tenth)),
                    " to ".join(map(shown, one.tenth_interval)),
                )
                for key, one in study.robust.items()
            ],
        )
    if study.sensitivities:
        print_sensitivities(stream, study.sensitivities, objective)
    if study.at_end:
        stream.write(
            f"{study.at_end:.1%} of the turned fibers would leave 0 to 180 deg and stay there.\n"
        )
    for key, penalty in study.shadows.items():
        stream.write(f"{titles[key]}: a bolt's shadows take {penalty:.1f} counts.\n")


def print_sensitivities(
    stream: IO[str], sensitivities: Sequence[Sensitivity], objective: ObjectiveName = "score"
) -> None:
    """Write the sensitivity table of an objective, the dearest tolerance first."""
    rows, digits = [], 2 if objective == "score" else 3
    for entry in sensitivities:
        unit, factor = UNITS.get(entry.name, ("%", 100.0))
        steepest = entry.slope[abs(entry.slope).argmax()] / factor
        rows.append(
            (
                entry.name,
                f"{entry.sigma * factor:.3g} {unit}",
                f"{steepest:+.3g} / {unit}",
                f"{entry.deviation:.{digits}f}",
                f"{entry.mean_loss:.{digits}f}",
                f"{entry.low_loss:.{digits}f} ± {entry.low_loss_se:.{digits}f}",
                "" if entry.worst_fiber is None else str(entry.worst_fiber),
            )
        )
    headings = ("sigma", "slope", "spread", "mean loss", "one in ten loses more", "fiber")
    costs = "counts of S" if objective == "score" else f"degrees of the {title_of(objective)}"
    title = f"What each tolerance alone costs, in {costs}"
    print_table(stream, title, ("tolerance", *headings), rows)
