"""Searches that render nothing: colors and directions on the model, the thesis's on the table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from optimize.design.design import Design, baseline_design
from optimize.design.limits import limits_of
from optimize.exploration.explore import PHI_NODES
from optimize.overnight.context import RunContext, design_json, design_of
from optimize.scoring.evaluate import TableScorer
from optimize.search.colors.grouped import grouped_colors
from optimize.search.colors.result import renamed_like
from optimize.search.directions import optimize_directions, population, tied_groups
from optimize.search.joint import SearchStep, optimize_jointly
from optimize.verification.thesis import GENERATIONS
from render.chebyshev import chebyshev_nodes, interpolation_weights
from render.geometry.layout import fiber_edges
from render.transport import TransportTable
from surrogate.runtime.checker import Checker


def baseline_of(context: RunContext) -> Design:
    """Return the design to beat."""
    return limits_of(context.scene).dimmed(baseline_design(context.scene))


def search_designs(context: RunContext, checker: Checker) -> tuple[Design, Design]:
    """Return the best colors at the baseline's directions, and the best design, on the model."""

    def search() -> dict[str, Any]:
        context.stage("Colors and directions on the surrogate", "search")
        table = checker.transport_table(chebyshev_nodes(PHI_NODES, 0.0, np.pi))
        steps: list[SearchStep] = []

        def report(step: SearchStep) -> None:
            steps.append(step)
            context.show(len(steps), len(steps) + 1)

        found = optimize_jointly(
            TableScorer(table, limits=limits_of(context.scene)),
            baseline_of(context),
            edges=fiber_edges(context.scene),
            seed=context.seed,
            progress=report,
        )
        colored = next(step for step in found.history if step.stage == "quick")
        return {
            "colors": design_json(colored.design),
            "best": design_json(found.design),
            "scores": [colored.score, found.score],
            "monochrome": found.monochrome,
        }

    kept = context.decide("search", search)
    context.keep_best("surrogate", kept["scores"][1], checker.score_reach, "found on the surrogate")
    return design_of(kept["colors"]), design_of(kept["best"])


def thesis_design(
    context: RunContext, table: Callable[[], TransportTable], checker: Checker
) -> Design | None:
    """Return what the thesis's procedure (4.3) makes of the reference table.

    Colors in pairs at the baseline's directions, then directions tied by side and color, by
    CMA-ES. None where the scene has constraints, which that procedure does not know.
    """
    if context.scene.constraints is not None:
        return None

    def search() -> dict[str, Any]:
        context.stage("Thesis-style design on the table", "thesis")
        rendered = table()
        at_bends = interpolation_weights(rendered.bends, context.bends)
        own = replace(
            rendered,
            T=np.einsum("ab,fjbsk->fjask", at_bends, rendered.T),
            se=np.einsum("ab,fjbsk->fjask", at_bends, rendered.se),
            bends=context.bends,
            background=None,
            background_se=None,
            exposure=checker.exposure,
            lam=checker.lam,
        )
        scorer, baseline = TableScorer(own), baseline_of(context)
        found = grouped_colors(scorer, baseline.phi)
        colors = renamed_like(found.colors, baseline.colors)
        colored = Design.of_colors(baseline.phi, colors)
        groups = tied_groups(fiber_edges(context.scene), colors)
        turned = optimize_directions(
            lambda phi: scorer.direction_scores(phi, colored.power),
            baseline.phi,
            groups=groups,
            bounds=scorer.phi_bounds,
            seed=context.seed,
            max_evaluations=1 + GENERATIONS * population(int(groups.max()) + 1),
        )
        return design_json(Design(turned.phi, colored.power)) | {"believed": turned.score}

    return design_of(context.decide("thesis", search))
