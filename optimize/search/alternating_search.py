"""Alternating search: colors, then directions, then colors again, until neither moves.

The thesis searches colors once, then directions once (4.3). Better directions can change which
colors are best, so both are repeated here: grouped and 2-opt colors, tied directions, then free
ones, each from the best design so far.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from optimize.design import Colors, Design, ScoredDesign, SearchLimits
from optimize.scoring import TableScorer, improves
from optimize.search.colors import (
    ColorResult,
    are_combinations,
    count_combinations,
    exact_colors,
    grouped_colors,
    quick_colors,
    renamed_like,
)
from optimize.search.directions import DirectionResult, optimize_directions, tied_groups
from optimize.search.local_refinement import refine_locally
from render.errors import DesignError

# A round that gains less than this fraction of the score ends the search.
TOLERANCE = 1e-3
MAX_ROUNDS = 10
MOST_COMBINED = 500_000
"""Colorings of few lamps or few runs that are scored as a whole, in a second of two cores."""


@dataclass(frozen=True, eq=False)
class SearchStep(ScoredDesign):
    """The best design after a stage, a point of the convergence plot.

    ``round`` is 0 for the start; ``stage`` is ``start``, ``grouped`` (or ``coarsely grouped``),
    ``quick`` (or ``exact``), ``tied``, ``free`` or ``power``. Lightings and seconds of wall time
    are those so far, all stages together.
    """

    round: int
    stage: str
    evaluated: int
    seconds: float


@dataclass(frozen=True, eq=False)
class AlternatingResult(ScoredDesign):
    """The best design; ``converged`` is False when the rounds ran out.

    ``proven`` is how many designs are allowed, where all were scored.
    """

    history: tuple[SearchStep, ...]
    converged: bool
    proven: int | None = None

    @property
    def colored(self) -> Design:
        """The design after the first search of single colors."""
        return next(step.design for step in self.history if step.stage in {"quick", "exact"})

    @property
    def evaluated(self) -> int:
        """Number of lightings scored."""
        return self.history[-1].evaluated

    @property
    def seconds(self) -> float:
        """Wall time."""
        return self.history[-1].seconds


def alternating_search(
    scorer: TableScorer,
    start: Design,
    *,
    edges: Sequence[str] | None = None,
    seed: int = 0,
    max_rounds: int = MAX_ROUNDS,
    progress: Callable[[SearchStep], None] | None = None,
) -> AlternatingResult:
    """Return the best design that alternating searches reach from ``start``.

    A stage without an allowed candidate is left out: where constraints break all pairs of
    neighbors, there is no ``grouped``.

    Arguments:
        scorer: the table, conventions and limits to search with.
        start: first design; its directions are the first ones that colors are chosen for. Where
            it breaks the limits, the nearest allowed design is taken.
        edges: the side of each fiber, for the tied search; None skips that stage.
        seed: of the random starts and of CMA-ES; every round draws anew.
        max_rounds: the search ends unconverged after so many rounds.
        progress: called after every stage.
    """
    limits, start = scorer.limits, scorer.limits.allowed_start(start)
    search = _Rounds(scorer, start, progress)
    steerable = len(scorer.table.phi) > 1
    for number in range(1, max_rounds + 1):
        before = search.score
        if number == 1:
            search.take_groups(number)
        phi, colors = search.design.phi, search.design.colors
        starts = [colors] if limits.may_be_off or (colors >= 0).all() else []
        if (
            are_combinations(limits)
            and count_combinations(limits, alike=scorer.colors_alike) <= MOST_COMBINED
        ):
            search.take_colors(number, exact_colors(scorer, phi))
        else:
            search.take_colors(number, quick_colors(scorer, phi, starts=starts, seed=seed + number))
        if steerable and edges is not None:
            groups = tied_groups(edges, search.design.colors)
            search.take_directions(number, "tied", groups, seed + number)
        if steerable:
            search.take_directions(number, "free", None, seed + number)
        if search.score - before < TOLERANCE * abs(before):
            return search.finished(number, converged=True)
    return search.finished(max_rounds, converged=False)


class _Rounds:
    """The best design so far and how it was reached; a stage never makes it worse.

    What gains no more than rounding is not taken: nobody rewires a sensor for that.
    """

    def __init__(
        self, scorer: TableScorer, start: Design, progress: Callable[[SearchStep], None] | None
    ) -> None:
        self.scorer, self.design, self.progress = scorer, start, progress
        self.names = start.colors
        self.score = scorer.score(start.phi, start.power)
        self.began = time.perf_counter()
        self.evaluated = 1
        self.history: list[SearchStep] = []
        self.proven: int | None = None
        self._record(0, "start")

    def take_colors(self, number: int, result: ColorResult) -> None:
        """Accept better colors, named so that most fibers keep the color of the start."""
        self.evaluated += result.evaluated
        limits = self.scorer.limits
        if limits.fixed_directions.all() and not limits.continuous_power:
            self.proven = result.evaluated if result.method == "exact" else None
        if improves(result.score, self.score):
            colors = result.colors
            if self.scorer.colors_alike:
                colors = renamed_like(colors, self.names, len(self.scorer.palette.names))
            self.design = self.scorer.design(self.design.phi, colors)
            self.score = result.score
        self._record(number, result.method)

    def take_groups(self, number: int) -> None:
        """Search colors in pairs or larger groups, where the limits leave any.

        Where most lamps stay off, or lamps are tied, there are no groups of neighbors, and pairs
        make no few runs.
        """
        limits = self.scorer.limits
        if limits.some_stay_off or limits.runs_limited or limits.ties is not None:
            return
        try:
            self.take_colors(number, grouped_colors(self.scorer, self.design.phi))
        except DesignError:
            if not limits.colors_limited:
                raise

    def take_directions(self, number: int, stage: str, groups: Colors | None, seed: int) -> None:
        """Search directions from the best design and accept better ones."""
        start, limits = self.design, self.scorer.limits

        def search(limits: SearchLimits) -> DirectionResult:
            return optimize_directions(
                lambda phi: self.scorer.direction_scores(phi, start.power),
                start.phi,
                groups=groups,
                bounds=self.scorer.phi_bounds,
                seed=seed,
                limits=limits,
            )

        result = search(limits)
        self._accept(replace(start, phi=result.phi), result.score, result.evaluated)
        if limits.holder is not None and groups is None:
            # The holder cuts the directions into regions, each with its optimum: the one next to
            # where a search without a holder ends is often better than the one found above.
            loose = search(replace(limits, holder=None))
            near = replace(start, phi=limits.nearest_directions(loose.phi))
            optimum = refine_locally(self.scorer, near)
            self._accept(optimum.design, optimum.score, loose.evaluated + optimum.evaluated)
        self._record(number, stage)

    def _accept(self, design: Design, score: float, evaluated: int) -> None:
        """Take a better design."""
        self.evaluated += evaluated
        if improves(score, self.score):
            self.design, self.score = design, score

    def finished(self, number: int, *, converged: bool) -> AlternatingResult:
        """Return the outcome, with powers of their own where the limits allow that."""
        if self.scorer.limits.continuous_power:
            optimum = refine_locally(self.scorer, self.design)
            self._accept(optimum.design, optimum.score, optimum.evaluated)
            self._record(number, "power")
        history = tuple(self.history)
        return AlternatingResult(self.design, self.score, history, converged, self.proven)

    def _record(self, number: int, stage: str) -> None:
        seconds = time.perf_counter() - self.began
        step = SearchStep(self.design, self.score, number, stage, self.evaluated, seconds)
        self.history.append(step)
        if self.progress is not None:
            self.progress(step)
