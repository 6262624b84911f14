"""The answers of a study, each kept in a folder as soon as it is there: stopped work goes on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from optimize.dimensions.answer import EFFORT_NAMES, Answer, StudyEffort, answer, answer_key
from optimize.dimensions.dimension import Values, Variants
from optimize.objectives import ReaderName, title_of
from optimize.ui.console import duration
from render.files import read_sealed, write_json
from render.progress import OnProgress, Progress

ANSWERS = "answers"
"""Folder of the answers in that of a study."""


class KeptAnswers:
    """Answers by values and effort: from a folder where they are kept, or asked for now.

    Arguments of the constructor:
        variants: whose sensors are asked about.
        reader, seed: see `answer`.
        folder: where answers are kept, None to keep them in memory alone.
        progress: told of every sensor.

    ``expected`` is how many sensors the present effort is asked about, or at most; 0 if unknown.
    """

    def __init__(
        self,
        variants: Variants,
        reader: ReaderName,
        seed: int,
        folder: Path | None,
        progress: OnProgress | None,
    ) -> None:
        self.variants, self.reader, self.seed = variants, reader, seed
        self.folder = folder
        self.tell = progress or (lambda _: None)
        self.expected = 0
        self._asked: dict[StudyEffort, list[float]] = {}
        self._known: dict[tuple[StudyEffort, Values], Answer] = {}

    def at(self, effort: StudyEffort, values: Values) -> Answer:
        """Return what an effort says about the sensor of ``values``."""
        if (effort, values) not in self._known:
            self._known[effort, values] = self._kept_or_asked(effort, values)
        return self._known[effort, values]

    def on(self, effort: StudyEffort) -> list[Values]:
        """Return the values that an effort has answered."""
        return [values for one, values in self._known if one == effort]

    def _kept_or_asked(self, effort: StudyEffort, values: Values) -> Answer:
        present = self.variants.present
        exposure = None if values == present else self.at(effort, present).scene_exposure
        scene = self.variants.at(values)
        key = answer_key(scene, effort, self.reader, self.seed, exposure)
        file = None if self.folder is None else self.folder / f"{key}.json"
        if file is not None and file.is_file():
            try:
                return Answer.from_json(read_sealed(file), scene)
            except (OSError, KeyError, TypeError, ValueError):
                pass  # cut off or altered: asked again
        found = answer(
            scene, effort, self.reader, self.seed, exposure, self._inside(effort, values)
        )
        if file is not None:
            about = {"values": list(values), "scene_hash": scene.hash}
            write_json(file, about | found.to_json())
        best = found.best.mean(self.reader)
        self._asked.setdefault(effort, []).append(found.seconds)
        text = (
            f"  {found.seconds:5.1f} s  {self.variants.shown(values):<16} "
            f"{title_of(self.reader)} {best:.2f}° with its best lights, {EFFORT_NAMES[effort]}"
        )
        to_come = self.expected - len(self.on(effort)) - 1
        if to_come > 0:
            spent = self._asked[effort]
            text += f"; {duration(to_come * sum(spent) / len(spent))} left for {to_come} more"
        self.tell(Progress.of_note(text))
        return found

    def _inside(self, effort: StudyEffort, values: Values) -> OnProgress:
        """Return what tells of the model of one sensor."""
        shown = self.variants.shown(values)
        if self.expected:
            shown += f" ({len(self.on(effort)) + 1} of {self.expected})"
        return lambda at: self.tell(replace(at, stage=f"{shown}, {at.stage}"))
