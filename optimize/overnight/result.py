"""What a finished night knows, and the files that keep it: all that its report is made from.

In the run directory: ``scene.toml`` (as the user wrote it), ``designs/<key>.json`` (design files),
``night.npz`` (arrays, no pickle) and ``night.json``, written last, with the SHA-256 of the others.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from optimize.design import (
    Array,
    Rating,
    ScoredDesign,
    ScoreSettings,
    load_design,
    load_design_file,
    save_design,
)
from optimize.scoring import student_factor
from render.errors import TactiluxError
from render.files import read_npz, write_npz, write_text
from render.metric import clipped_fraction, design_score
from render.scene import Scene, load_scene, scene_text

SCENE, ARRAYS, NIGHT, DESIGNS = "scene.toml", "night.npz", "night.json", "designs"

Key = Annotated[str, Field(pattern=r"^[a-z][a-z-]{0,31}$")]
StandardError = Annotated[float, Field(ge=0.0)]
Trade = dict[str, float | str | None]
_STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, ser_json_inf_nan="constants")


class ResultError(TactiluxError):
    """The files of a finished night are missing, damaged, or of another version."""


@dataclass(frozen=True, eq=False)
class FinalistFigures:
    """Numbers of a verified design, as ``night.json`` holds them.

    Arguments:
        key: ``baseline``, ``colors``, ``thesis``, ``winner`` or ``runner-up``; names files.
        title: for people.
        score, se: S of eq. (4.7) from renders (level reference), counts, and its standard error.
        gain, gain_se: S minus the baseline's from the same renders; None for the baseline.
        predicted, predicted_reach: the surrogate's S and the half-width of its 90 % interval.
    """

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT

    key: Key
    title: str
    score: float
    se: StandardError
    gain: float | None
    gain_se: StandardError | None
    predicted: float
    predicted_reach: StandardError


@dataclass(frozen=True, eq=False)
class Finalist(FinalistFigures, ScoredDesign):
    """A design that was verified by renders of its own, beside the surrogate's opinion of it.

    Arguments:
        counts, counts_se: rendered colors ``(bend, site, facet, 3)`` in camera counts.
        predicted_counts: the surrogate's, same axes.
        metric, metric_se: rendered M of eq. (4.6), ``(bend, site)``.
    """

    counts: Array
    counts_se: Array
    predicted_counts: Array
    metric: Array
    metric_se: Array

    @property
    def clipped(self) -> float:
        """Fraction of rendered facets that saturate the camera."""
        return float(clipped_fraction(self.counts))


_ARRAYS = ("counts", "counts_se", "predicted_counts", "metric", "metric_se")


@dataclass(frozen=True)
class ConvergencePoint:
    """One rendered design of one round.

    Arguments:
        stage: which part of the night rendered it.
        round: number of its round, from 1.
        role: why it was rendered (``baseline``, ``best``, ``uncertain``, ``random``, ...).
        render_seconds: of the night until its round was done.
        score, se: rendered; predicted: by the surrogate of that time.
    """

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT

    stage: str
    round: Annotated[int, Field(ge=0)]
    role: str
    render_seconds: StandardError
    score: float
    se: StandardError
    predicted: float


@dataclass(frozen=True)
class ResultFile:
    """The content of ``night.json``; its fields are its keys, see `OvernightResult`."""

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT

    schema: Literal[1]
    scene_hash: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
    replicates: Annotated[int, Field(ge=2)]
    finalists: tuple[FinalistFigures, ...]
    winner: Key
    verdict: tuple[str, ...]
    steps: tuple[ConvergencePoint, ...]
    trade: tuple[Trade, ...]
    facts: tuple[tuple[str, str], ...]
    files: dict[str, str]


_FILE = TypeAdapter(ResultFile)


@dataclass(frozen=True, eq=False)
class OvernightResult:
    """Everything that the report of a night shows.

    Arguments:
        scene: the sensor.
        settings: exposure, lambda and conventions of every score here.
        replicates: independent replicates behind every standard error.
        finalists: the baseline first.
        winner: key of the design that is handed over; the baseline's, if nothing beat it.
        verdict: sentences with their statistics, the most important first.
        steps: what was rendered on the way, in order.
        trade: speed and accuracy by level: ``level``, ``seconds_per_design``,
            ``facet_error_median``, ``facet_error_p95``, ``score_error``, ``kendall_tau``.
        facts: versions, hashes, seeds, budget and seconds spent, in the order shown.
    """

    scene: Scene
    settings: ScoreSettings
    replicates: int
    finalists: tuple[Finalist, ...]
    winner: str
    verdict: tuple[str, ...]
    steps: tuple[ConvergencePoint, ...]
    trade: tuple[Trade, ...]
    facts: tuple[tuple[str, str], ...]

    def of(self, key: str) -> Finalist | None:
        """Return the finalist of that key, or None if the night had none."""
        return next((entry for entry in self.finalists if entry.key == key), None)

    def finalist(self, key: str) -> Finalist:
        """Return the finalist of that key, which the night has."""
        return next(entry for entry in self.finalists if entry.key == key)

    @property
    def interval_factor(self) -> float:
        """Standard errors on either side of a value that make its 95 % interval (Student's t)."""
        return student_factor(self.replicates)

    def rating(self, finalist: Finalist) -> Rating:
        """Return the rating that goes into the finalist's design file."""
        parts = design_score(finalist.metric, self.settings.conventions)
        values = {name: float(getattr(parts, name)) for name in ("spread_sites", "spread_bends")}
        values |= {"score": finalist.score, "mean": float(parts.mean)}
        half = self.interval_factor * finalist.se
        interval = (finalist.score - half, finalist.score + half)
        return self.settings.rating("reference", values, interval)

    def save(self, run: Path) -> None:
        """Write the night into ``run``, every file atomically and ``night.json`` last.

        Equal nights make equal bytes. ``scene.toml`` must be there (see `keep_scene`).

        Raises:
            ResultError: ``run`` has no scene file, or another scene's.
            DesignError: a number that is not finite.
        """
        self._check(run)
        write_npz(
            run / ARRAYS,
            {f"{e.key}/{name}": getattr(e, name) for e in self.finalists for name in _ARRAYS},
        )
        for entry in self.finalists:
            path = run / DESIGNS / f"{entry.key}.json"
            save_design(path, entry.design, self.scene, self.rating(entry))
        names = [ARRAYS, SCENE, *(f"{DESIGNS}/{entry.key}.json" for entry in self.finalists)]
        file = ResultFile(
            schema=1,
            scene_hash=self.scene.hash,
            files={name: _sha256(run / name) for name in names},
            **{name: getattr(self, name) for name in _SHARED},
        )
        text = _FILE.dump_json(file, indent=1)
        _validated(text, "the night to be saved")
        write_text(run / NIGHT, text.decode() + "\n")

    @classmethod
    def load(cls, run: Path) -> OvernightResult:
        """Return the night in ``run``.

        Raises:
            ResultError: says in one sentence which file is missing, damaged or foreign.
        """
        file = _read(run)
        scene = load_scene(run / SCENE)
        if scene.hash != file.scene_hash:
            raise ResultError(
                f"{run / NIGHT} was made for the scene of hash {file.scene_hash}, but "
                f"{run / SCENE} has hash {scene.hash}: run tactilux overnight in a new directory",
                field="scene_hash",
                value=file.scene_hash,
                allowed=scene.hash,
            )
        arrays = read_npz(run / ARRAYS)
        kept = {name: getattr(file, name) for name in _SHARED}
        kept["finalists"] = tuple(_finalist(run, scene, e, arrays) for e in file.finalists)
        result = cls(scene=scene, settings=_settings(run), **kept)
        result._check(run)
        return result

    def _check(self, run: Path) -> None:
        """Refuse what a report could not show."""
        keys = [entry.key for entry in self.finalists]
        if not keys or keys[0] != "baseline" or len(set(keys)) < len(keys):
            raise ResultError(
                f"the finalists are {keys}, allowed: the baseline first, each once",
                field="finalists",
            )
        if self.winner not in keys:
            raise ResultError(
                f"winner = {self.winner!r}, allowed: one of {', '.join(keys)}", field="winner"
            )
        cells = (len(self.scene.bending.angles), self.scene.sites.count)
        for entry in self.finalists:
            for name in _ARRAYS:
                shape, found = _shape(name, cells, self.scene), getattr(entry, name)
                if found.shape != shape or not np.isfinite(found).all():
                    raise ResultError(
                        f"{name} of {entry.key} has shape {found.shape}, allowed: finite values of "
                        f"shape {shape}",
                        field=name,
                    )
        if not (run / SCENE).is_file() or load_scene(run / SCENE).hash != self.scene.hash:
            raise ResultError(
                f"{run / SCENE} is missing or holds another scene than {self.scene.name} of hash "
                f"{self.scene.hash}: run tactilux overnight in a new directory",
                field="scene",
            )


_SHARED = {f.name for f in fields(OvernightResult)} & {f.name for f in fields(ResultFile)}


def keep_scene(run: Path, name_or_path: str | Path) -> Scene:
    """Copy a scene file into ``run``, with its comments and sources, and return what it holds."""
    load_scene(name_or_path)
    write_text(run / SCENE, scene_text(name_or_path))
    return load_scene(run / SCENE)


def _read(run: Path) -> ResultFile:
    """Return the content of ``night.json``, if all files that belong to it are whole."""
    path = run / NIGHT
    try:
        file = _validated(path.read_bytes(), str(path))
    except OSError as error:
        raise ResultError(
            f"{path} cannot be read ({error.strerror}): a report needs a night that has come to "
            "its end, go on with tactilux overnight",
            field="run",
            value=str(run),
        ) from None
    wanted = {ARRAYS, SCENE, *(f"{DESIGNS}/{entry.key}.json" for entry in file.finalists)}
    if set(file.files) != wanted:
        raise ResultError(f"{path} does not name the files that belong to it", field="files")
    for name, digest in file.files.items():
        try:
            whole = _sha256(run / name) == digest
        except OSError:
            whole = False
        if not whole:
            raise ResultError(
                f"{run / name} is missing or is not the file that {NIGHT} was written with: go on "
                "with tactilux overnight, which writes it anew from the renders",
                field="files",
                value=name,
            )
    return file


def _settings(run: Path) -> ScoreSettings:
    path = run / DESIGNS / "baseline.json"
    rating = load_design_file(path).rating
    if rating is None:
        raise ResultError(f"{path} has no rating: it is no finalist's", field="score")
    return rating.settings


def _finalist(
    run: Path, scene: Scene, figures: FinalistFigures, arrays: Mapping[str, Array]
) -> Finalist:
    design = load_design(run / DESIGNS / f"{figures.key}.json", scene)
    kept: dict[str, Any] = {}
    for name in _ARRAYS:
        array = arrays.get(f"{figures.key}/{name}")
        if array is None or array.dtype != np.float64:
            raise ResultError(
                f"{run / ARRAYS} has no float64 array {figures.key}/{name}", field=name
            )
        kept[name] = array
    return Finalist(**vars(figures), **kept, design=design)


def _shape(name: str, cells: tuple[int, int], scene: Scene) -> tuple[int, ...]:
    return cells if name.startswith("metric") else (*cells, scene.indenter.faces, 3)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _validated(text: bytes, origin: str) -> ResultFile:
    """Return the content of ``night.json``, or name the first fields that are wrong."""
    try:
        return _FILE.validate_json(text)
    except ValidationError as error:
        problems = error.errors(include_url=False)
    words = [f"{'.'.join(map(str, p['loc'])) or 'the file'}: {p['msg']}" for p in problems[:3]]
    raise ResultError(
        f"{origin} is not a valid record of a night: {'; '.join(words)}",
        field=".".join(map(str, problems[0]["loc"])),
    )
