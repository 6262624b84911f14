"""The quick job: a better lighting design for a scene, searched and rated on the surrogate."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from optimize.design.design import Design, Rating, baseline_design
from optimize.design.limits import limits_of
from optimize.exploration.stages import Stage
from optimize.scoring.evaluate import TableScorer
from optimize.search.joint import JointResult, SearchStep, optimize_jointly
from render.chebyshev import chebyshev_nodes
from render.geometry.layout import fiber_edges
from render.metric import clipped_fraction, design_score
from render.scene.schema import Scene
from surrogate.runtime.checker import Checker

if TYPE_CHECKING:
    from optimize.robust.study import Study

# Direction nodes of the table that is searched: its interpolation then moves a score by less than
# 0.1 counts (measured; with 17 nodes by 0.9).
PHI_NODES = 33


@dataclass(frozen=True, eq=False)
class Exploration:
    """What the quick job found: baseline, after the colors, and the result, all rated.

    With ``study``, the last stage is the design that was refined for tolerances or shadows.
    """

    scene: Scene
    checker: Checker
    stages: tuple[Stage, ...]
    search: JointResult
    seed: int
    seconds: float
    study: Study | None = None

    @property
    def design(self) -> Design:
        """The design that was found."""
        return self.stages[-1].design

    @property
    def rating(self) -> Rating:
        """What the surrogate says of it."""
        return self.stages[-1].rating

    def to_json(self, design: Path, report: Path, seconds: float) -> dict[str, object]:
        """Return what programs rely on."""
        result: dict[str, object] = {
            "scene": self.scene.name,
            "scene_hash": self.scene.hash,
            "baseline": _figures(self.stages[0].rating),
            "optimized": _figures(self.stages[-1].rating),
            "design": str(design),
            "report": str(report),
            "seconds": round(seconds, 3),
        }
        if self.study is not None:
            result["study"] = self.study.to_json()
        return result


def explore(
    scene: Scene,
    checker: Checker,
    *,
    seed: int = 0,
    progress: Callable[[SearchStep], None] | None = None,
) -> Exploration:
    """Search colors and directions from the baseline until neither moves, and rate the stages.

    The search keeps to the scene's constraints; the baseline only to those of LED power.
    """
    began = time.perf_counter()
    table = checker.transport_table(chebyshev_nodes(PHI_NODES, 0.0, np.pi))
    limits = limits_of(scene)
    baseline = limits.dimmed(baseline_design(scene))
    search = optimize_jointly(
        TableScorer(table, limits=limits),
        baseline,
        edges=fiber_edges(scene),
        seed=seed,
        progress=progress,
    )
    colored = next(step for step in search.history if step.stage == "quick")
    first_round = [step.score for step in search.history if step.round == 1]
    later = "the fiber directions"
    if search.score > first_round[-1]:
        later += " and the rounds after"
    chosen = [
        ("baseline", "Baseline", "", baseline),
        ("colors", "Colors", "the color search", colored.design),
        ("optimized", "Optimized", later, search.design),
    ]
    stages = tuple(rate(checker, scene, *entry) for entry in chosen)
    return Exploration(scene, checker, stages, search, seed, time.perf_counter() - began)


def rate(
    checker: Checker, scene: Scene, key: str, title: str, change: str, design: Design
) -> Stage:
    """Return the stage of ``design`` with everything that checker.onnx says about it."""
    bends = np.array(scene.bending.angles)
    found = {
        name: np.asarray(value[0], dtype=np.float64)
        for name, value in checker.run(design.phi[None], design.power[None], bends).items()
    }
    parts = design_score(found["metric"])
    score, reach = float(found["score"]), checker.score_reach
    rating = Rating(
        level="surrogate",
        score=score,
        interval=(score - reach, score + reach),
        mean=float(parts.mean),
        spread_sites=float(parts.spread_sites),
        spread_bends=float(parts.spread_bends),
        lam=checker.lam,
        exposure=checker.exposure,
    )
    return Stage(
        key=key,
        title=title,
        change=change,
        design=design,
        rating=rating,
        metric=found["metric"],
        counts=found["counts"],
        clipped=float(clipped_fraction(found["counts"])),
        domain_excess=float(found["domain_excess"]),
    )


def _figures(rating: Rating) -> dict[str, object]:
    return {
        "score": rating.score,
        "interval": list(rating.interval),
        "level": rating.level,
        "mean": rating.mean,
        "spread_sites": rating.spread_sites,
        "spread_bends": rating.spread_bends,
    }
