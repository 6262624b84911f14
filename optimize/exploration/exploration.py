"""The quick job: a better lighting design for a scene, searched and rated on its model."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from optimize.design import (
    PARTS,
    Array,
    Design,
    RatedDesign,
    Rating,
    ScoreSettings,
    dimmed_baseline,
    limits_of,
)
from optimize.reconstruction import normal_error
from optimize.scoring import TableScorer, predict_design, search_table
from optimize.search import AlternatingResult, SearchStep, alternating_search
from render.geometry import fiber_edges
from render.metric import clipped_fraction, design_score
from render.scene import Scene
from surrogate.runtime import Checker, RankingTest


@dataclass(frozen=True, eq=False)
class Stage(RatedDesign):
    """A design of one stage of an exploration, with what the model says about it.

    Arguments:
        key: ``baseline``, ``colors`` or ``optimized``; names files.
        title: for people.
        change: what this stage did, to follow "by".
        metric: M of eq. (4.6), ``(bend, site)``.
        counts: what the camera records, ``(bend, site, facet, 3)``.
        clipped: fraction of facets that saturate.
        domain_excess: 0 inside the model's range, positive outside.
        normal_error: mean error of recovered normals in degrees, see `optimize.reconstruction`.
        photon_noise: of facet colors, relative, where a preview of followed light rated it.
    """

    key: str
    title: str
    change: str
    metric: Array
    counts: Array
    clipped: float
    domain_excess: float
    normal_error: float
    photon_noise: float | None = None

    def __repr__(self) -> str:
        """Return the score with its interval in one line."""
        low, high = self.rating.interval
        return (
            f"<Stage {self.title} of {self.scene.name}: score {self.rating.score:.1f} "
            f"({low:.1f} to {high:.1f}), {self.rating.level}>"
        )


class StudyResult(Protocol):
    """What a study of the stages adds, for example by `optimize.robust`."""

    def to_json(self) -> dict[str, object]:
        """Return what programs rely on."""

    def facts(self, titles: Mapping[str, str]) -> list[tuple[str, str]]:
        """Return lines of the report; ``titles`` names the stages by key."""


@dataclass(frozen=True, eq=False)
class Exploration:
    """What the quick job found: baseline, after the colors, and the result, all rated.

    With ``study``, the last stage is the design that was refined for tolerances or shadows.
    """

    scene: Scene
    checker: Checker
    stages: tuple[Stage, ...]
    search: AlternatingResult
    seed: int
    seconds: float
    study: StudyResult | None = None

    def __repr__(self) -> str:
        """Return in one line what was gained, and on which level."""
        first, last = self.stages[0].rating.score, self.rating
        return (
            f"<Exploration of {self.scene.name}: score {first:.1f} -> {last.score:.1f}, "
            f"{last.level}, {len(self.stages)} stages>"
        )

    def _repr_html_(self) -> str:
        """Return the line, a table of the stages, and the design that was found."""
        from render.notebook import tabled

        rows = []
        for stage in self.stages:
            low, high = stage.rating.interval
            scores = f"{stage.rating.score:.1f}", f"{low:.1f} to {high:.1f}"
            rows.append((stage.title, *scores, f"{stage.normal_error:.2f}"))
        names = ("stage", "score, counts", "90 % interval", "normal error, deg")
        return tabled(repr(self), names, rows) + self.design._repr_html_()

    @property
    def design(self) -> Design:
        """The design that was found."""
        return self.stages[-1].design

    @property
    def rating(self) -> Rating:
        """What the model says of it."""
        return self.stages[-1].rating

    @property
    def ranking(self) -> RankingTest:
        """Whether the model has shown that it can rank designs."""
        return RankingTest.of(self.checker.metadata)

    def to_json(self, design: Path, report: Path, seconds: float) -> dict[str, object]:
        """Return what programs rely on."""
        result: dict[str, object] = {
            "scene": self.scene.name,
            "scene_hash": self.scene.hash,
            "baseline": stage_to_json(self.stages[0]),
            "optimized": stage_to_json(self.stages[-1]),
            "design": str(design),
            "report": str(report),
            "ranking": {"kendall_tau": self.ranking.tau, "reliable": self.ranking.reliable},
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

    The search keeps to the scene's constraints, and begins at the allowed design nearest to the
    baseline; the baseline keeps only to those of LED power. ``progress`` is told the scores that
    the model itself gives, as the stages have them: those of the table that is searched differ by
    what its interpolation misses.
    """
    began = time.perf_counter()
    baseline, bends = dimmed_baseline(scene), np.array(scene.state_axis)

    def rated(step: SearchStep) -> None:
        if progress is not None:
            said = predict_design(checker, step.design, bends)["score"]
            progress(replace(step, score=float(said)))

    search = alternating_search(
        TableScorer(search_table(checker), limits=limits_of(scene)),
        baseline,
        edges=fiber_edges(scene),
        seed=seed,
        progress=rated,
    )
    colored = next(step for step in search.history if step.stage == "quick")
    first_round = [step.score for step in search.history if step.round == 1]
    change = "the fiber directions" if any(scene.turning) else "further rounds"
    if any(scene.turning) and search.score > first_round[-1]:
        change += " and the rounds after"
    chosen = [
        ("baseline", "Baseline", "", baseline),
        ("colors", "Colors", "the color search", colored.design),
        ("optimized", "Optimized", change, search.design),
    ]
    stages = tuple(rate(checker, scene, *entry) for entry in chosen)
    return Exploration(scene, checker, stages, search, seed, time.perf_counter() - began)


def rate(
    checker: Checker, scene: Scene, key: str, title: str, change: str, design: Design
) -> Stage:
    """Return the stage of ``design`` with everything that its model says about it."""
    output = predict_design(checker, design, np.array(scene.state_axis))
    score, half = float(output["score"]), checker.score_half_width
    parts = {name: float(part) for name, part in vars(design_score(output["metric"])).items()}
    rating = ScoreSettings(checker.exposure, checker.lam).rating(
        checker.level, parts | {"score": score}, (score - half, score + half)
    )
    return Stage(
        scene=scene,
        key=key,
        title=title,
        change=change,
        design=design,
        rating=rating,
        metric=output["metric"],
        counts=output["counts"],
        clipped=float(clipped_fraction(output["counts"])),
        domain_excess=float(output["domain_excess"]),
        normal_error=normal_error(scene, (output["counts"], output["background"])),
        photon_noise=checker.photon_noise,
    )


def stage_to_json(stage: Stage) -> dict[str, object]:
    """Return score, parts and normal error of a design as programs are told them.

    ``photon_noise`` is null but on a preview whose light was followed.
    """
    rating = stage.rating
    return {
        **{name: getattr(rating, name) for name in PARTS},
        "interval": list(rating.interval),
        "level": rating.level,
        "photon_noise": stage.photon_noise,
        "normal_error_deg": stage.normal_error,
    }
