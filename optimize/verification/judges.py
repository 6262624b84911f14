"""What decides between designs: the degrees of a reader, or the score S.

A judge has one figure for rendered designs and for those of a table. More is better: degrees count
negative, and are `told` as they are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

from optimize.design import Array, Design, ScoreSettings
from optimize.objectives import ObjectiveName, ReaderName, sign_of, unit_of
from optimize.readers import CameraModel, ModelColors, RenderedDegrees, rendered_degrees
from optimize.scoring import JackknifeEstimate, TableScorer
from optimize.search import (
    NominalScore,
    Objective,
    ReaderObjective,
    alternating_search,
    search_by_reader,
)
from optimize.verification.design_renders import DesignRenders
from render.geometry import fiber_edges
from render.scene import Scene
from surrogate.runtime import Checker


@dataclass(frozen=True, eq=False)
class Judged(ABC):
    """Some rendered designs under a judge, and what readers make of them."""

    judge: Judge
    renders: DesignRenders

    @abstractmethod
    def value(self, index: int) -> JackknifeEstimate:
        """Return the figure of a design."""

    @abstractmethod
    def difference(self, first: int, second: int) -> JackknifeEstimate:
        """Return the figure of the second design minus that of the first, paired."""

    def degrees(self, reader: ReaderName) -> RenderedDegrees:
        """Return what a reader misses on the designs; it is found once."""
        if reader not in self._found:
            judge, (colors, known) = self.judge, self._colors
            found = rendered_degrees(judge.scene, colors, readers=[reader], model=known)
            self._found.update(found)
        return self._found[reader]

    @cached_property
    def _found(self) -> dict[ReaderName, RenderedDegrees]:
        return {}

    @cached_property
    def _colors(self) -> tuple[Array, ModelColors | None]:
        known = ModelColors.of(self.judge.model, self.renders.designs)
        return self.renders.colors(self.judge.settings), known


@dataclass(frozen=True, eq=False)
class Judge(ABC):
    """What decides between designs of ``scene``.

    ``settings`` are those of its scores; ``model`` helps to read noisy renders, see
    `rendered_degrees`.
    """

    scene: Scene
    settings: ScoreSettings
    model: Checker | None

    @property
    @abstractmethod
    def objective(self) -> ObjectiveName:
        """How users call it."""

    @property
    @abstractmethod
    def by(self) -> str:
        """What a design is better by, in a sentence."""

    @abstractmethod
    def judged(self, renders: DesignRenders) -> Judged:
        """Return what renders say."""

    @abstractmethod
    def on_table(self, scorer: TableScorer) -> Objective:
        """Return the same figure of designs on a table."""

    @abstractmethod
    def search(self, scorer: TableScorer, start: Design, seed: int) -> Design:
        """Return the best design on a table, within its limits, of a search from ``start``."""

    @property
    def sign(self) -> float:
        """By which a figure is multiplied to be told: degrees count negative here."""
        return sign_of(self.objective)

    def told(self, value: float, sign: str = "") -> str:
        """Return a figure as people read it, or a difference, with ``sign`` "+"."""
        return f"{self.sign * value:{sign}.2f}{unit_of(self.objective)}"


class ScoreJudge(Judge):
    """S of eq. (4.7), at the scene's exposure."""

    @property
    def objective(self) -> ObjectiveName:
        """How users call it."""
        return "score"

    @property
    def by(self) -> str:
        """What a design is better by."""
        return "in S"

    def judged(self, renders: DesignRenders) -> Judged:
        """Return scores."""
        return _Scored(self, renders)

    def on_table(self, scorer: TableScorer) -> Objective:
        """Return S on a table."""
        return NominalScore(scorer)

    def search(self, scorer: TableScorer, start: Design, seed: int) -> Design:
        """Return what alternating searches of colors and directions reach."""
        return alternating_search(scorer, start, edges=fiber_edges(self.scene), seed=seed).design


@dataclass(frozen=True, eq=False)
class ReaderJudge(Judge):
    """Minus the expected error of ``reader`` in degrees, at each design's own exposure."""

    reader: ReaderName

    @property
    def objective(self) -> ObjectiveName:
        """How users call it."""
        return self.reader

    @property
    def by(self) -> str:
        """What a design is better by."""
        return f"for the {self.reader} reader"

    def judged(self, renders: DesignRenders) -> Judged:
        """Return minus degrees."""
        return _Read(self, renders)

    def on_table(self, scorer: TableScorer) -> Objective:
        """Return minus degrees on a table."""
        return ReaderObjective(scorer, self.scene, self.reader, CameraModel.of(self.scene))

    def search(self, scorer: TableScorer, start: Design, seed: int) -> Design:
        """Return what searches reach from ``start`` and from random colorings."""
        first = scorer.limits.allowed_start(start)
        return search_by_reader(scorer, self.on_table(scorer), [first], seed=seed).design


def judge_of(
    objective: ObjectiveName, scene: Scene, settings: ScoreSettings, model: Checker | None = None
) -> Judge:
    """Return the judge that users call ``objective``."""
    if objective == "score":
        return ScoreJudge(scene, settings, model)
    return ReaderJudge(scene, settings, model, objective)


class _Scored(Judged):
    def value(self, index: int) -> JackknifeEstimate:
        return self.renders.score(self.judge.settings, index).score

    def difference(self, first: int, second: int) -> JackknifeEstimate:
        return self.renders.difference(self.judge.settings, first, second)


@dataclass(frozen=True, eq=False)
class _Read(Judged):
    judge: ReaderJudge

    def value(self, index: int) -> JackknifeEstimate:
        return -self.degrees(self.judge.reader).errors[index]

    def difference(self, first: int, second: int) -> JackknifeEstimate:
        return -self.degrees(self.judge.reader).difference(first, second)
