"""What a finished night knows, and the files that keep it: all that its report is made from.

In the run directory: ``scene.toml`` (as the user wrote it), ``designs/<key>.json`` (design files),
``night.npz`` (arrays, no pickle) and ``night.json``, written last, with the SHA-256 of the others.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from optimize.design.design import Array, Design, Rating
from optimize.design.design_file import load_design, load_saved, save_design
from optimize.scoring.score_scale import Scale
from optimize.ui.atomic import write_text
from render.errors import TactiluxError
from render.files import read_npz, write_npz
from render.metric import clipped_fraction, design_score
from render.scene.schema import Scene, load_scene, scene_text

SCENE, ARRAYS, NIGHT, DESIGNS = "scene.toml", "night.npz", "night.json", "designs"
CONFIDENCE = 0.95


class ResultError(TactiluxError):
    """The files of a finished night are missing, damaged, or of another version."""


@dataclass(frozen=True, eq=False)
class Finalist:
    """A design that was verified by renders of its own, beside the surrogate's opinion of it.

    Arguments:
        key: ``baseline``, ``colors``, ``thesis``, ``winner`` or ``runner-up``; names files.
        title: for people.
        design: directions and LED powers.
        score, se: S of eq. (4.7) from renders (level reference), counts, and its standard error.
        gain, gain_se: S minus the baseline's from the same renders; None for the baseline.
        predicted, predicted_reach: the surrogate's S and the half-width of its 90 % interval.
        counts, counts_se: rendered colors ``(bend, site, facet, 3)`` in camera counts.
        predicted_counts: the surrogate's, same axes.
        metric, metric_se: rendered M of eq. (4.6), ``(bend, site)``.
    """

    key: str
    title: str
    design: Design
    score: float
    se: float
    gain: float | None
    gain_se: float | None
    predicted: float
    predicted_reach: float
    counts: Array
    counts_se: Array
    predicted_counts: Array
    metric: Array
    metric_se: Array

    @property
    def clipped(self) -> float:
        """Fraction of rendered facets that saturate the camera."""
        return float(clipped_fraction(self.counts))


@dataclass(frozen=True)
class ConvergencePoint:
    """One rendered design of one round: a point of the convergence plot.

    Arguments:
        stage: which part of the night rendered it.
        round: number of its round, from 1.
        role: why it was rendered (``baseline``, ``best``, ``uncertain``, ``random``, ...).
        render_seconds: of the night until its round was done.
        score, se: rendered; predicted: by the surrogate of that time.
    """

    stage: str
    round: int
    role: str
    render_seconds: float
    score: float
    se: float
    predicted: float


@dataclass(frozen=True, eq=False)
class OvernightResult:
    """Everything that the report of a night shows.

    Arguments:
        scene: the sensor.
        scale: exposure, lambda and conventions of every score here.
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
    scale: Scale
    replicates: int
    finalists: tuple[Finalist, ...]
    winner: str
    verdict: tuple[str, ...]
    steps: tuple[ConvergencePoint, ...]
    trade: tuple[Mapping[str, float | str | None], ...]
    facts: tuple[tuple[str, str], ...]

    def of(self, key: str) -> Finalist | None:
        """Return the finalist of that key, or None if the night had none."""
        return next((entry for entry in self.finalists if entry.key == key), None)

    def finalist(self, key: str) -> Finalist:
        """Return the finalist of that key, which the night has."""
        return next(entry for entry in self.finalists if entry.key == key)

    @property
    def reach(self) -> float:
        """Standard errors on either side of a value that make its 95 % interval (Student's t)."""
        from scipy.special import stdtrit

        return float(stdtrit(self.replicates - 1, 0.5 + CONFIDENCE / 2))

    def rating(self, finalist: Finalist) -> Rating:
        """Return the rating that goes into the finalist's design file."""
        parts = design_score(finalist.metric, self.scale.conventions)
        values = {name: float(getattr(parts, name)) for name in ("spread_sites", "spread_bends")}
        values |= {"score": finalist.score, "mean": float(parts.mean)}
        half = self.reach * finalist.se
        interval = (finalist.score - half, finalist.score + half)
        return self.scale.rating("reference", values, interval)

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
        content = {
            "schema": 1,
            "scene_hash": self.scene.hash,
            "replicates": self.replicates,
            "finalists": [
                {name: getattr(entry, name) for name in _FIGURES} for entry in self.finalists
            ],
            "winner": self.winner,
            "verdict": list(self.verdict),
            "steps": [asdict(step) for step in self.steps],
            "trade": [dict(row) for row in self.trade],
            "facts": list(self.facts),
            "files": {name: _sha256(run / name) for name in names},
        }
        try:
            file = _File.model_validate(content)
        except ValidationError as error:
            raise _refusal("the night to be saved", error) from None
        write_text(run / NIGHT, file.model_dump_json(by_alias=True, indent=1) + "\n")

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
        result = cls(
            scene=scene,
            scale=_scale(run),
            replicates=file.replicates,
            finalists=tuple(_finalist(run, scene, entry, arrays) for entry in file.finalists),
            winner=file.winner,
            verdict=tuple(file.verdict),
            steps=tuple(ConvergencePoint(**dict(step)) for step in file.steps),
            trade=tuple(file.trade),
            facts=tuple((name, value) for name, value in file.facts),
        )
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


def keep_scene(run: Path, name_or_path: str | Path) -> Scene:
    """Copy a scene file into ``run``, with its comments and sources, and return what it holds."""
    load_scene(name_or_path)
    write_text(run / SCENE, scene_text(name_or_path))
    return load_scene(run / SCENE)


_FIGURES = ("key", "title", "score", "se", "gain", "gain_se", "predicted", "predicted_reach")
_ARRAYS = tuple(f.name for f in fields(Finalist) if f.name not in (*_FIGURES, "design"))

Key = Annotated[str, Field(pattern=r"^[a-z][a-z-]{0,31}$")]
Spread = Annotated[float, Field(ge=0.0)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _Finalist(_Part):
    key: Key
    title: str
    score: float
    se: Spread
    gain: float | None
    gain_se: Spread | None
    predicted: float
    predicted_reach: Spread


class _Step(_Part):
    stage: str
    round: Annotated[int, Field(ge=0)]
    role: str
    render_seconds: Spread
    score: float
    se: Spread
    predicted: float


class _File(_Part):
    schema_version: Annotated[Literal[1], Field(alias="schema")]
    scene_hash: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
    replicates: Annotated[int, Field(ge=2)]
    finalists: list[_Finalist]
    winner: Key
    verdict: list[str]
    steps: list[_Step]
    trade: list[dict[str, float | str | None]]
    facts: list[tuple[str, str]]
    files: dict[str, str]


def _read(run: Path) -> _File:
    """Return the content of ``night.json``, if all files that belong to it are whole."""
    path = run / NIGHT
    try:
        file = _File.model_validate_json(path.read_bytes())
    except OSError as error:
        raise ResultError(
            f"{path} cannot be read ({error.strerror}): a report needs a night that has come to "
            "its end, go on with tactilux overnight",
            field="run",
            value=str(run),
        ) from None
    except ValidationError as error:
        raise _refusal(str(path), error) from None
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


def _scale(run: Path) -> Scale:
    path = run / DESIGNS / "baseline.json"
    rating = load_saved(path).rating
    if rating is None:
        raise ResultError(f"{path} has no rating: it is no finalist's", field="score")
    return Scale(rating.exposure, rating.lam, rating.conventions)


def _finalist(
    run: Path, scene: Scene, entry: _Finalist, arrays: Mapping[str, np.ndarray]
) -> Finalist:
    design = load_design(run / DESIGNS / f"{entry.key}.json", scene)
    found: dict[str, Any] = {}
    for name in _ARRAYS:
        array = arrays.get(f"{entry.key}/{name}")
        if array is None or array.dtype != np.float64:
            raise ResultError(f"{run / ARRAYS} has no float64 array {entry.key}/{name}", field=name)
        found[name] = array
    return Finalist(**dict(entry), **found, design=design)


def _shape(name: str, cells: tuple[int, int], scene: Scene) -> tuple[int, ...]:
    return cells if name.startswith("metric") else (*cells, scene.indenter.faces, 3)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _refusal(origin: str, error: ValidationError) -> ResultError:
    problems = error.errors(include_url=False)
    words = [
        f"{'.'.join(map(str, item['loc'])) or 'the file'}: {item['msg']}" for item in problems[:3]
    ]
    return ResultError(
        f"{origin} is not a valid record of a night: {'; '.join(words)}",
        field=".".join(map(str, problems[0]["loc"])),
    )
