"""A study of dimensions: what the numbers of a scene file are worth, each with its own best lights.

One dimension, or few combinations of several, are a grid; others are searched by CMA-ES. All
sensors are answered on one effort, the best of them and the present one then on a finer one.
Every answer is kept in a folder as soon as it is there, so that a stopped study goes on.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from optimize.design import Design
from optimize.dimensions.answer import (
    Answer,
    StudyEffort,
    exposed_like,
    model_at,
)
from optimize.dimensions.dimension import Values, Variants
from optimize.dimensions.kept_answers import KeptAnswers
from optimize.dimensions.relative_change import RelativeChange, relative_change
from optimize.dimensions.stepped_search import Point, stepped_search
from optimize.exploration import Stage, rate
from optimize.objectives import READERS, ReaderName, title_of
from optimize.placement import ending_in
from render.progress import OnProgress
from render.scene import Scene, rewritten

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PER_DIMENSION = 20
"""Sensors that a search may look at; no more of them are a grid."""
MOST_NAMED = 8
"""Sensors that a sentence names."""
FINALISTS = 1
"""Sensors beside the present one that the finer effort answers."""


@dataclass(frozen=True, eq=False)
class StudyRow:
    """A sensor of a study.

    Arguments:
        values: of the dimensions, in the file's units.
        answer: what the effort says.
        changes: of each reader's error with the best lights, from the present sensor with its best
            lights; empty for that sensor itself.
    """

    values: Values
    answer: Answer
    changes: Mapping[ReaderName, RelativeChange]

    def to_json(self) -> dict[str, Any]:
        """Return plain data: errors in degrees, changes as fractions."""
        lights = {"baseline": self.answer.baseline, "best": self.answer.best}
        return {
            "values": list(self.values),
            "effort": self.answer.effort,
            **{
                f"{name}_{reader}_deg": errors.mean(reader)
                for name, errors in lights.items()
                for reader in READERS
            },
            "changes": {reader: one.to_json() for reader, one in self.changes.items()},
            "proven_best_of": self.answer.proven,
            "photon_noise": self.answer.photon_noise,
            "seconds": self.answer.seconds,
        }


@dataclass(frozen=True, eq=False)
class Study:
    """What a study found.

    Arguments:
        variants: the dimensions, and the sensor of each combination of values.
        reader: whose degrees decide.
        seed: of all searches.
        rows: of all sensors that were looked at, the present one among them, in the order of their
            values.
        finalists: the same of the finer effort, the present sensor first; none where it was not
            asked.
        seconds: of wall time, this run alone.
    """

    variants: Variants
    reader: ReaderName
    seed: int
    rows: tuple[StudyRow, ...]
    finalists: tuple[StudyRow, ...]
    seconds: float

    def __repr__(self) -> str:
        """Return the study in one line."""
        return f"<Study of {self.scene.name}: {self.sentence}>"

    def _repr_html_(self) -> str:
        """Return the sentence and the table."""
        from optimize.dimensions.study_page import table_of
        from render.notebook import tabled

        return tabled(self.sentence, *table_of(self))

    def plot(self) -> Figure:
        """Return a figure of the errors over the values."""
        from optimize.dimensions.study_page import study_figure

        return study_figure(self)

    @property
    def scene(self) -> Scene:
        """The sensor as it is."""
        return self.variants.scene

    @property
    def judged(self) -> tuple[StudyRow, ...]:
        """The rows that decide: the finalists, or all where there is one effort."""
        return self.finalists or self.rows

    @cached_property
    def pareto(self) -> frozenset[Values]:
        """The values that no other row beats: none has less error at no more of any cost.

        Empty where no number of which a builder wants little is varied.
        """
        costs = [number for number, one in enumerate(self.variants.dimensions) if one.is_cost]
        points = [
            (
                row.values,
                [row.values[number] for number in costs],
                row.answer.best.mean(self.reader),
            )
            for row in self.rows
        ]

        def beaten(cost: list[float], error: float) -> bool:
            return any(
                all(low <= high for low, high in zip(other, cost, strict=True))
                and (less < error or (less == error and other != cost))
                for _, other, less in points
            )

        return frozenset(values for values, cost, error in points
                         if costs and not beaten(cost, error))  # fmt: skip

    @property
    def leading(self) -> StudyRow:
        """The other sensor whose error is least: of those that are certain to be better, if any."""
        changes = {row: row.changes[self.reader] for row in self.judged if row.changes}
        return min(changes, key=lambda row: (not changes[row].lower, changes[row].value))

    @property
    def present(self) -> StudyRow:
        """The row of the sensor as it is, on the effort that decides."""
        return next(row for row in self.judged if not row.changes)

    @property
    def chosen(self) -> StudyRow:
        """The row of the best sensor: that as it is, unless another is certain to be better."""
        lead = self.leading
        return lead if lead.changes[self.reader].lower else self.present

    @cached_property
    def best(self) -> Stage:
        """The best sensor and its lights, rated: ``best.scene``, ``best.design``."""
        title = "Best" if self.chosen.changes else "As it is"
        return self.rated(self.chosen, "best", title, self.best_scene)

    @property
    def best_scene(self) -> Scene:
        """The sensor of the best row as a scene file of its own, which says where it is from."""
        if not self.chosen.changes:
            return self.variants.at(self.variants.present)
        values = self.chosen.values
        source = f"chosen by tactilux explore {self.scene.name} {self.flags}: {self.sentence}"
        changes: dict[str, Any] = {
            key: {**change, "source": source} if isinstance(change, Mapping) else change
            for key, change in self.variants.changes(values).items()
        }
        scene = exposed_like(
            self.variants.searched(self.scene.with_(**changes)),
            self.chosen.answer.scene_exposure,
            self.present.answer.scene_exposure,
        )
        return rewritten(scene, source, name=ending_in(self.scene.name, "-best"))

    def scene_of(self, row: StudyRow) -> Scene:
        """Return the sensor of a row with its places, which exposes no longer than the present."""
        scene = self.variants.at(row.values)
        if not row.changes or self.variants.one_sensor:
            return scene
        like = next(one for one in self.rows if not one.changes)
        return exposed_like(scene, row.answer.scene_exposure, like.answer.scene_exposure)

    @property
    def flags(self) -> str:
        """The dimensions as the command line has them."""
        words = [
            f"--vary {one.key}={','.join(f'{value:g}' for value in one.values)}"
            for one in self.variants.dimensions
        ]
        words += ["--lamps-follow"] * self.variants.lamps_follow
        return " ".join(words + self.variants.space.flags)

    @property
    def sentence(self) -> str:
        """What came out, in one sentence."""
        lead, shown = self.leading, self.variants.shown
        change, title = lead.changes[self.reader], title_of(self.reader)
        pair = f"{shown(lead.values)} instead of {shown(self.variants.present)}"
        if change.lower:
            return f"{pair}: {title} {change.words}."
        return (
            f"No other sensor is certain to be better; the best of them, {pair}: {title} "
            f"{change.words}."
        )

    @property
    def worse(self) -> str:
        """Which sensors are certain to be worse, in one sentence; empty where none is."""
        last = {row.values: row for row in self.rows + self.finalists}
        shown = [
            self.variants.shown(values)
            for values, row in last.items()
            if row.changes and row.changes[self.reader].higher
        ]
        if not shown:
            return ""
        more = f" and {len(shown) - MOST_NAMED} more" if len(shown) > MOST_NAMED else ""
        return f"Certain to be worse: {'; '.join(shown[:MOST_NAMED])}{more}."

    def warnings(self) -> list[str]:
        """Return what makes the result doubtful, or where to look further; usually nothing."""
        texts = []
        for number, one in enumerate(self.variants.dimensions):
            value, ends = self.leading.values[number], {one.values[0], one.values[-1]}
            if one.is_limit:
                continue
            if len(one.values) > 2 and value in ends and self.chosen.changes:
                texts.append(
                    f"{one.key} = {one.shown(value)} is at the end of its range: a wider one may "
                    "hold a better sensor."
                )
        if self.chosen.changes:
            other = next(reader for reader in READERS if reader != self.reader)
            if self.leading.changes[other].interval[0] > 0.0:
                texts.append(
                    f"The {title_of(other)} is worse there: {self.leading.changes[other].words}."
                )
        return texts

    def rated(self, row: StudyRow, key: str, title: str, scene: Scene) -> Stage:
        """Return what the effort of a row says about its lights, as `tactilux.rate` does."""
        design: Design = row.answer.design
        checker = model_at(scene, row.answer.effort)
        return rate(checker, scene, key, title, "", design)

    def to_json(self) -> dict[str, Any]:
        """Return what programs rely on."""
        return {
            "scene": self.scene.name,
            "scene_hash": self.scene.hash,
            "vary": [
                {
                    "key": one.key,
                    "unit": one.unit,
                    "values": list(one.values),
                    "present": one.present,
                }
                for one in self.variants.dimensions
            ],
            "objective": self.reader,
            "seed": self.seed,
            "sensors": len(self.variants),
            "rows": [row.to_json() | {"pareto": row.values in self.pareto} for row in self.rows],
            "finalists": [row.to_json() for row in self.finalists],
            "best": self.chosen.to_json(),
            "sentence": self.sentence,
            "worse": self.worse,
            "warnings": self.warnings(),
            "seconds": round(self.seconds, 3),
        }


def run_study(
    variants: Variants,
    *,
    reader: ReaderName = "sensor",
    coarse: bool = False,
    seed: int = 0,
    folder: Path | None = None,
    progress: OnProgress | None = None,
) -> Study:
    """Return what the dimensions of ``variants`` are worth.

    Arguments:
        variants: the sensors.
        reader: whose degrees decide.
        coarse: ask the preview as drawn alone, in seconds a sensor.
        seed: of all searches.
        folder: in which answers are kept; the same study goes on from there.
        progress: told of every sensor.
    """
    began = time.monotonic()
    answers = KeptAnswers(variants, reader, seed, folder, progress)
    first = first_effort(variants, coarse=coarse)
    _ask(answers, first)
    rows = _rows(answers, first, answers.on(first))
    finalists: tuple[StudyRow, ...] = ()
    if first != "converged" and not coarse:
        others = sorted(
            (row for row in rows if row.changes), key=lambda row: row.changes[reader].value
        )
        chosen = [variants.present, *(row.values for row in others[:FINALISTS])]
        answers.expected = len(chosen)
        finalists = _rows(answers, "converged", chosen, ordered=False)
    return Study(variants, reader, seed, rows, finalists, time.monotonic() - began)


def first_effort(variants: Variants, *, coarse: bool) -> StudyEffort:
    """Return the effort that answers about every sensor of a study.

    Few light paths behind a diffuser leave so much noise that the preview as drawn is better. Where
    limits of designs alone are varied, light is followed once for all.
    """
    if variants.one_sensor and not coarse:
        return "converged"
    return "drawn" if coarse or variants.scene.diffuser is not None else "few"


def _ask(answers: KeptAnswers, effort: StudyEffort) -> None:
    """Ask an effort about all sensors, or about those that a search wants to know of."""
    variants, most = answers.variants, PER_DIMENSION * len(answers.variants.dimensions)
    grid = len(variants.dimensions) == 1 or len(variants) <= most
    answers.expected = len({*variants, variants.present}) if grid else most + 1
    answers.at(effort, variants.present)
    if grid:
        for values in variants:
            answers.at(effort, values)
        return
    axes = [one.values for one in variants.dimensions]

    def values_at(point: Point) -> Values:
        return tuple(axis[number] for axis, number in zip(axes, point, strict=True))

    def loss(point: Point) -> float:
        return float(np.log(answers.at(effort, values_at(point)).best.mean(answers.reader)))

    stepped_search(
        loss,
        [len(axis) for axis in axes],
        _nearest(variants, axes),
        most=most,
        allowed=lambda point: values_at(point) in variants,
        seed=answers.seed,
    )


def _nearest(variants: Variants, axes: Sequence[Sequence[float]]) -> Point:
    """Return the sensor whose values are nearest to the present ones, in ranges of the values."""
    spans = [max(axis) - min(axis) or 1.0 for axis in axes]

    def distance(values: Values) -> float:
        pairs = zip(values, variants.present, spans, strict=True)
        return sum(((value - present) / span) ** 2 for value, present, span in pairs)

    near = min(variants, key=distance)
    return tuple(list(axis).index(value) for axis, value in zip(axes, near, strict=True))


def _rows(
    answers: KeptAnswers, effort: StudyEffort, chosen: Sequence[Values], *, ordered: bool = True
) -> tuple[StudyRow, ...]:
    """Return the rows of some sensors, held against the present one on the same effort.

    More of a limit is never worse: a row has the best design of all that it allows.
    """
    present = answers.variants.present
    for values in chosen:
        answers.at(effort, values)

    answered = set(answers.on(effort))

    def row(values: Values) -> StudyRow:
        # What is allowed with less is allowed with more: a search may have missed it there.
        allowed = [answers.at(effort, one) for one in answers.variants.within(values)
                   if one in answered]  # fmt: skip
        said = min(allowed, key=lambda one: one.best.mean(answers.reader))
        changes: dict[ReaderName, RelativeChange] = {}
        if values != present:
            for reader in READERS:
                changes[reader] = relative_change(base, said.best, reader, effort, count)
        return StudyRow(values, said, changes)

    base, count = row(present).answer.best, max(len(chosen) - 1, 1)
    return tuple(row(values) for values in (sorted(chosen) if ordered else chosen))
