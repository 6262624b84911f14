"""What tolerances and shadows do to the designs of an exploration, and a design made for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from optimize.design import Design, limits_of
from optimize.exploration import PHI_NODES, Exploration, rate
from optimize.robust.material_slopes import MATERIALS, material_slopes
from optimize.robust.robust import Measure, RobustRating, RobustScore, rate_robustly
from optimize.robust.sensitivity import Sensitivity, sensitivities
from optimize.robust.shadow import ShadowPenalty
from optimize.robust.tolerance_draws import BuiltSensors
from optimize.scoring import TableScorer
from optimize.search import NominalScore, Objective, WeightedSum, multi_start
from optimize.search.colors import quick_colors, renamed_like
from render.chebyshev import chebyshev_nodes
from render.errors import SceneError
from render.scene.schema import Scene

SEARCH_DRAWS, RATING_DRAWS = 48, 1000
COLORINGS = 6
"""Best colorings of the nominal search that get directions of their own."""
Report = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Study:
    """Ratings of all stages beyond their nominal score.

    Arguments:
        measure: what the robust search maximized; None without one.
        robust: by stage key, over sensors that the search did not see.
        shadows: by stage key, the penalty in counts; shadow_weight: of it in the search.
        sensitivities: of the last stage, the dearest tolerance first.
        at_end: part of fiber directions that errors turned beyond 0 to 180 deg in the last stage.
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
            "sensitivities": [sensitivity_json(entry) for entry in self.sensitivities],
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


def sensitivity_json(entry: Sensitivity) -> dict[str, object]:
    """Return plain data of one line of the sensitivity table."""
    return {**vars(entry), "slope": entry.slope.tolist(), "worst_fiber": entry.worst_fiber}


def check_tolerances(scene: Scene) -> None:
    """Refuse a scene without tolerances.

    Raises:
        SceneError: there is no tolerance to be robust against.
    """
    if scene.tolerances is None or not scene.tolerances.spreads():
        raise SceneError(
            f"scene {scene.name} has no tolerances: add a [tolerances] section to its file, for "
            'example led_power = { distribution = "normal", deviation = 0.05, unit = "relative", '
            'source = "data sheet" }',
            field="tolerances",
        )


def study(
    found: Exploration, measure: Measure | None, shadow_weight: float | None, report: Report
) -> Exploration:
    """Return the exploration with one more stage, the design for tolerances or shadows.

    Arguments:
        found: the nominal exploration.
        measure: over tolerances; None leaves them out.
        shadow_weight: of the shadow penalty; None leaves it out.
        report: called with a title, steps done and steps in all.

    Raises:
        SceneError: tolerances are asked for, and the scene has none.
    """
    scene, checker = found.scene, found.checker
    table = checker.transport_table(chebyshev_nodes(PHI_NODES, 0.0, np.pi))
    scorer = TableScorer(table, limits=limits_of(scene))
    goal: Objective = NominalScore(scorer)
    shadow = None if shadow_weight is None else ShadowPenalty(scene, table)
    sensors = None
    if measure is not None:
        check_tolerances(scene)
        sensors = _sensors(scene, scorer, found.seed, report)
        goal = RobustScore(sensors[0], measure)
    if shadow is not None and shadow_weight is not None:
        goal = WeightedSum((1.0, goal), (shadow_weight, shadow))
    best = found.stages[-1].design
    top = quick_colors(scorer, best.phi, starts=[best.colors], seed=found.seed).top
    colorings = [np.array(row) for row, _ in top[:COLORINGS]]
    if scorer.colors_alike:
        colorings = [renamed_like(row, best.colors) for row in colorings]
    starts = [best, *(Design(best.phi, scorer.power(row)) for row in colorings)]
    design = multi_start(scorer, goal, starts, lambda i, n: report("Refining", i, n)).design
    titles = [title for title, used in (("Robust", measure), ("Shadow-aware", shadow)) if used]
    stage = rate(
        checker, scene, "refined", " and ".join(titles).capitalize(), "the refinement", design
    )
    stages = (*found.stages, stage)
    spreads = scene.tolerances.spreads() if scene.tolerances and sensors else {}
    ratings: dict[str, RobustRating] = {}
    costs: tuple[Sensitivity, ...] = ()
    at_end = 0.0
    if sensors is not None:
        _, fresh, slopes = sensors
        for index, entry in enumerate(stages):
            ratings[entry.key] = rate_robustly(scorer, fresh, entry.design)
            report("Rating", index + 1, len(stages) + 1)
        costs = tuple(sensitivities(scorer, design, spreads, slopes, seed=found.seed))
        report("Rating", len(stages) + 1, len(stages) + 1)
        at_end = fresh.at_end(design.phi)
    shadows = {} if shadow is None else {e.key: -shadow.value(e.design) for e in stages}
    more = Study(measure, ratings, shadows, shadow_weight, costs, at_end)
    return replace(found, stages=stages, study=more)


def _sensors(
    scene: Scene, scorer: TableScorer, seed: int, report: Report
) -> tuple[BuiltSensors, BuiltSensors, dict[str, np.ndarray]]:
    """Return sensors to search on, others to rate on, and the slopes of their materials."""
    assert scene.tolerances is not None  # checked before
    spreads = scene.tolerances.spreads()
    names: list[str] = [n for n in MATERIALS if n in spreads]
    slopes = material_slopes(
        scene, names, scorer.table.phi, lambda i, n: report("Previews of other materials", i, n)
    )

    def drawn(draws: int, stream: int) -> BuiltSensors:
        return BuiltSensors(scorer, spreads, slopes, draws=draws, seed=1000 * seed + stream)

    return drawn(SEARCH_DRAWS, 1), drawn(RATING_DRAWS, 2), slopes
