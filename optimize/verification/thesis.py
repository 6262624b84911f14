"""The thesis's own procedure (4.3), kept as a runnable baseline: every candidate is rendered.

Colors first: one render per fiber, superposed, searched over pairs in both phases with boundary
repair (4.3.1). Then directions tied by side and color, by CMA-ES over renders, until the steps are
small or 20 generations are over (4.3.2). Scores are plain, as there: noise biases them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from optimize.design import Array, Design, ScoreSettings, SearchLimits
from optimize.scoring import TableScorer
from optimize.search import DirectionResult, optimize_directions, population, tied_groups
from optimize.search.colors import grouped_colors, renamed_like
from optimize.verification.design_renders import DesignRenders, RenderDesigns
from render.reference import PRESSED
from render.transport import TransportTable

GENERATIONS = 20


@dataclass(frozen=True, eq=False)
class ThesisResult:
    """What the procedure found.

    Arguments:
        design: its result; colored: after the colors alone.
        score: what it believes S of the result to be.
        directions: the direction search.
        runs: number of renders; seconds: of rendering.
    """

    design: Design
    colored: Design
    score: float
    directions: DirectionResult
    runs: int
    seconds: float


def thesis_procedure(
    baseline: Design,
    render: RenderDesigns,
    *,
    edges: Sequence[str],
    limits: SearchLimits,
    settings: ScoreSettings,
    samples: int,
    seed: int,
    render_seed: int,
    generations: int = GENERATIONS,
    report: Callable[[int, int, float], None] | None = None,
) -> ThesisResult:
    """Return what grouped colors and tied directions reach on renders.

    Arguments:
        baseline: directions that colors are searched at, names of colors.
        render: renders one design.
        edges: the side of each fiber.
        limits: which fibers turn.
        settings: of the scores.
        samples: per cell and candidate.
        seed: of CMA-ES.
        render_seed: of every render, so that candidates share random numbers.
        generations: of CMA-ES at most.
        report: called with candidates rendered, candidates at most, and the best score.
    """
    first = render(
        [baseline],
        samples=samples,
        seeds=[render_seed],
        title="single fibers",
        allocation=PRESSED,
    )
    seconds, runs = first.seconds, 1
    scorer = TableScorer(_table(first, settings), settings.conventions, limits=limits)
    colored, groups = colored_groups(scorer, baseline, edges)
    limit = 1 + generations * population(int(groups.max()) + 1)

    def score(phi: Array) -> Array:
        nonlocal seconds, runs
        out = []
        for row in phi:
            rendered = render(
                [replace(colored, phi=row)],
                samples=samples,
                seeds=[render_seed],
                title=f"candidate {runs} of at most {limit}",
                allocation=PRESSED,
            )
            seconds, runs = seconds + rendered.seconds, runs + 1
            transport = rendered.replicates[:, 0].mean(axis=0)
            out.append(float(settings.parts(transport, colored.power)[0]))
        return np.array(out)

    def progress(evaluated: int, best: float) -> None:
        if report is not None:
            report(evaluated, limit, best)

    turned = optimize_directions(
        score,
        baseline.phi,
        groups=groups,
        limits=limits,
        seed=seed,
        max_evaluations=limit,
        progress=progress,
    )
    return ThesisResult(
        replace(colored, phi=turned.phi), colored, turned.score, turned, runs, seconds
    )


def colored_groups(
    scorer: TableScorer, baseline: Design, edges: Sequence[str]
) -> tuple[Design, np.ndarray]:
    """Return the best colors in pairs at the baseline's directions, and fibers that turn as one."""
    colors = grouped_colors(scorer, baseline.phi).colors
    if scorer.colors_alike:
        colors = renamed_like(colors, baseline.colors, len(baseline.palette.names))
    return Design.of_colors(baseline.phi, colors, baseline.palette), tied_groups(edges, colors)


def thesis_on_table(
    scorer: TableScorer, baseline: Design, edges: Sequence[str], seed: int
) -> Design:
    """Return what the procedure makes of a table that knows all directions; nothing is rendered."""
    colored, groups = colored_groups(scorer, baseline, edges)
    turned = optimize_directions(
        lambda phi: scorer.direction_scores(phi, colored.power),
        baseline.phi,
        groups=groups,
        bounds=scorer.phi_bounds,
        limits=scorer.limits,
        seed=seed,
        max_evaluations=1 + GENERATIONS * population(int(groups.max()) + 1),
    )
    return replace(colored, phi=turned.phi)


def _table(renders: DesignRenders, settings: ScoreSettings) -> TransportTable:
    """Return the table of one design's renders, with its directions as the only node."""
    replicates = renders.replicates[:, 0]
    error = replicates.std(axis=0, ddof=1) / np.sqrt(len(replicates))
    return TransportTable(
        T=replicates.mean(axis=0)[:, None],
        se=error[:, None],
        phi=renders.designs[0].phi[:1],
        exposure=settings.exposure,
        lam=settings.lam,
    )
