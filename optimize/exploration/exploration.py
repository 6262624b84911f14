"""The quick job: a better lighting design for a scene, searched and rated on its model."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
from optimize.objectives import ERROR_KEYS, READERS, ObjectiveName, ReaderName
from optimize.readers import (
    CameraModel,
    ErrorComparison,
    Reading,
    compare_readings,
    likely_errors,
    reading,
    reads_better,
)
from optimize.scoring import (
    JackknifeEstimate,
    TableScorer,
    predict_design,
    predicted_colors,
    search_table,
)
from optimize.search import (
    AlternatingResult,
    ReaderObjective,
    SearchStep,
    alternating_search,
    search_by_reader,
)
from render.geometry import fiber_edges
from render.metric import clipped_fraction, design_score
from render.progress import OnProgress
from render.scene import Scene
from surrogate.runtime import Checker, RankingTest


@dataclass(frozen=True, eq=False)
class Stage(RatedDesign):
    """A design of one stage of an exploration, with what the model says about it.

    Arguments:
        key: ``baseline``, ``colors``, ``score`` or ``optimized``; names files.
        title: for people.
        change: what this stage did, to follow "by".
        metric: M of eq. (4.6), ``(bend, site)``.
        counts: what the camera records, ``(bend, site, facet, 3)``.
        clipped: fraction of facets that saturate.
        domain_excess: 0 inside the model's range, positive outside.
        photon_noise: of facet colors, relative, where traced light alone rated it.
        rendered: readers' errors in degrees by renders; of a model, unless it was rendered.
    """

    key: str
    title: str
    change: str
    metric: Array
    counts: Array
    clipped: float
    domain_excess: float
    reading: Reading
    photon_noise: float | None = None
    rendered: Mapping[ReaderName, JackknifeEstimate] = field(default_factory=dict)

    def error(self, reader: ReaderName) -> float:
        """Return the mean error of a reader in degrees, by renders where there are any."""
        found = self.rendered.get(reader)
        return float(getattr(self.reading, reader).mean) if found is None else found.value

    @property
    def error_map(self) -> Array | None:
        """Degrees that the *sensor* reader misses on the model, ``(state, site)``."""
        return None if self.rendered else self.reading.sensor.map

    @property
    def normal_error(self) -> float:
        """Mean error in degrees of the *place* reader, the ideal lookup."""
        return self.error("place")

    @property
    def reader_error(self) -> float:
        """Mean error in degrees of the *sensor* reader, as people train one."""
        return self.error("sensor")

    def __repr__(self) -> str:
        """Return the score with its interval in one line."""
        low, high = self.rating.interval
        return (
            f"<Stage {self.title} of {self.scene.name}: score {self.rating.score:.1f} "
            f"({low:.1f} to {high:.1f}), {self.rating.level_name}>"
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
    ``readings`` hold what was found against the baseline, in degrees on common noise, see
    `compare_readings`; unless the reader of ``objective`` misses less, the baseline is handed over,
    where it is allowed.
    ``proven`` is how many designs are allowed, where all were compared by S, or by the expected
    error of that reader, and the best is handed over.
    """

    scene: Scene
    checker: Checker
    stages: tuple[Stage, ...]
    search: AlternatingResult
    seed: int
    seconds: float
    objective: ObjectiveName = "score"
    readings: Mapping[str, ErrorComparison] = field(default_factory=dict)
    study: StudyResult | None = None
    proven: int | None = None

    def __repr__(self) -> str:
        """Return in one line what was gained, and on which level."""
        first, last = self.stages[0].rating.score, self.rating
        return (
            f"<Exploration of {self.scene.name}: score {first:.1f} -> {last.score:.1f}, "
            f"{last.level_name}, {len(self.stages)} stages>"
        )

    def _repr_html_(self) -> str:
        """Return the line, a table of the stages, and the design that was found."""
        from render.notebook import tabled

        rows = []
        for stage in self.stages:
            low, high = stage.rating.interval
            scores = f"{stage.rating.score:.1f}", f"{low:.1f} to {high:.1f}"
            rows.append(
                (stage.title, *scores, f"{stage.reader_error:.2f}", f"{stage.normal_error:.2f}")
            )
        names = (
            "stage",
            "score, counts",
            "90 % interval",
            "sensor reader, deg",
            "place reader, deg",
        )
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
    def proof(self) -> str:
        """Among which designs none is better on this level, or that nobody knows, in one sentence.

        Empty where all designs are allowed, or the baseline is handed over.
        """
        words = limits_of(self.scene).words
        if self.proven is None:
            kept = np.array_equal(self.design.drive, self.stages[0].design.drive)
            if kept or not words:
                return ""
            return (
                f"Not proven to be the best of all designs{words}: swaps climbed from many starts."
            )
        by = "S" if self.objective == "score" else (
            f"the expected error of the {self.objective} reader"
        )  # fmt: skip
        return f"The best of all {self.proven:,} designs{words}, compared by {by}."

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
            "objective": self.objective,
            "readings": {name: entry.to_json() for name, entry in self.readings.items()},
            "proven_best_of": self.proven,
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
    objective: ObjectiveName = "sensor",
    seed: int = 0,
    starts: Sequence[Design] = (),
    progress: Callable[[SearchStep], None] | None = None,
    report: OnProgress | None = None,
) -> Exploration:
    """Search colors and directions from the baseline until neither moves, and rate the stages.

    The search for S comes first; that for a reader's degrees starts from what it found, from the
    baseline and from random colorings. It keeps to the scene's constraints, and begins at the
    allowed design nearest to the baseline; the baseline keeps only to those of LED power. That for
    degrees goes on from ``starts`` too, allowed designs that are known already.
    ``progress`` is told the scores that the model itself gives, as the stages have them: those of
    the table that is searched differ by what its interpolation misses. ``report`` is told how far
    the search for a reader is.
    """
    began = time.perf_counter()
    baseline, bends = dimmed_baseline(scene), np.array(scene.state_axis)

    def rated(step: SearchStep) -> None:
        if progress is not None:
            said = predict_design(checker, step.design, bends)["score"]
            progress(replace(step, score=float(said)))

    scorer = TableScorer(search_table(checker), limits=limits_of(scene))
    search = alternating_search(
        scorer,
        baseline,
        edges=fiber_edges(scene),
        seed=seed,
        progress=rated,
    )
    first_round = [step.score for step in search.history if step.round == 1]
    change = "the fiber directions" if any(scene.turning) else "further rounds"
    if any(scene.turning) and search.score > first_round[-1]:
        change += " and the rounds after"
    readings: Mapping[str, ErrorComparison] = {}
    proven = search.proven
    stages = [rate(checker, scene, "baseline", "Baseline", "", baseline)]
    if objective == "score":
        stages += [
            rate(checker, scene, "colors", "Colors", "the color search", search.colored),
            rate(checker, scene, "optimized", "Optimized", change, search.design),
        ]
    else:
        goal = ReaderObjective(scorer, scene, objective, CameraModel.of(scene))
        first = search.history[0].design
        known = [first, search.design, *starts]
        best = search_by_reader(scorer, goal, known, seed=seed, progress=report)
        found, proven = best.design, best.allowed
        rated(replace(search.history[-1], design=found, stage="reader",
                      seconds=time.perf_counter() - began))  # fmt: skip
        stages.append(rate(checker, scene, "score", "Best S", "the search for S", search.design))
        last = "optimized", "Optimized", f"the search for the {objective} reader"
        stages.append(rate(checker, scene, *last, found))
        readings = compare_readings(stages[0].reading, stages[-1].reading)
        # Nobody rewires a sensor for a tie; with fewer lamps than it has, somebody must.
        kept = bool(scorer.limits.fits(baseline.colors[None])[0])
        if kept and not reads_better(stages[0].reading, stages[-1].reading, objective):
            stages[-1], proven = rate(checker, scene, *last, first), None
    seconds = time.perf_counter() - began
    return Exploration(
        scene, checker, tuple(stages), search, seed, seconds, objective, readings, proven=proven
    )


def rate(
    checker: Checker, scene: Scene, key: str, title: str, change: str, design: Design
) -> Stage:
    """Return the stage of ``design`` with everything that its model says about it."""
    output = predict_design(checker, design, np.array(scene.state_axis))
    score, half = float(output["score"]), checker.score_half_width
    parts = {name: float(part) for name, part in vars(design_score(output["metric"])).items()}
    rating = ScoreSettings(checker.exposure, checker.lam).rating(
        checker.level, parts | {"score": score}, (score - half, score + half), checker.effort
    )
    errors = likely_errors(checker, design)
    read = reading(scene, predicted_colors(checker, design), errors=errors)
    return Stage(
        scene=scene,
        key=key,
        title=title,
        change=change,
        design=design,
        rating=replace(rating, read=read.errors),
        metric=output["metric"],
        counts=output["counts"],
        clipped=float(clipped_fraction(output["counts"])),
        domain_excess=float(output["domain_excess"]),
        reading=read,
        photon_noise=checker.photon_noise,
    )


def stage_to_json(stage: Stage) -> dict[str, object]:
    """Return score, parts and normal error of a design as programs are told them.

    ``photon_noise`` is null but on a preview that traced light alone corrects.
    """
    rating = stage.rating
    return {
        **{name: getattr(rating, name) for name in PARTS},
        "interval": list(rating.interval),
        "level": rating.level,
        "effort": rating.effort,
        "photon_noise": stage.photon_noise,
        **{f"{key}_deg": stage.error(reader) for reader, key in ERROR_KEYS.items()},
        "readers": {name: getattr(stage.reading, name).to_json() for name in READERS},
    }
