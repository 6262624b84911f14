"""What a finished night knows, and the files that keep it: all that its report is made from.

In the run directory: ``scene.toml`` (as the user wrote it) with the files that it names,
``night.npz`` (arrays and JSON, no pickle), ``measured.json`` (what a clock or a machine has a part
in) and, for all other commands, ``designs/<key>.json`` (design files with rendered ratings).
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from optimize.design import SCENE, Array, Design, Rating, ScoreSettings, save_design
from optimize.objectives import ObjectiveName, ReaderName
from optimize.overnight.run_directory import RunError
from optimize.scoring import IntervalCheck, check_interval, student_factor
from render.errors import TactiluxError
from render.files import parse_json, read_npz, read_sealed, write_json, write_npz
from render.geometry import counted_sites
from render.metric import clipped_fraction
from render.refused_values import problem_sentence
from render.scene import Scene, load_scene

NIGHT, MEASURED, DESIGNS = "night.npz", "measured.json", "designs"
SCHEMA = 4
TITLES = {
    "baseline": "Baseline",
    "colors": "Colors",
    "score": "Best S",
    "thesis": "Thesis-style design",
    "winner": "Winner",
    "runner-up": "Runner-up",
}
"""What finalists are called, by their keys, which name files."""

StandardError = Annotated[float, Field(ge=0.0)]
_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)


@dataclass(frozen=True)
class RenderedFigure:
    """What an objective says of a finalist, in counts of S, or in degrees of a reader's error.

    Arguments:
        value, se: rendered, with its standard error.
        gain, gain_se: value minus the baseline's from the same renders; None for the baseline.
        predicted: by the surrogate.
    """

    __pydantic_config__: ClassVar[ConfigDict] = _CONFIG

    value: float
    se: StandardError
    gain: float | None
    gain_se: StandardError | None
    predicted: float


@dataclass(frozen=True, eq=False)
class Finalist:
    """A design that was verified by renders of its own, beside the surrogate's opinion of it.

    Arguments:
        key: one of `TITLES`.
        design: directions and LED powers.
        rating: S of eq. (4.7) from renders (level reference) with its parts and 95 % interval.
        se: standard error of S, counts.
        gain, gain_se: S minus the baseline's from the same renders; None for the baseline.
        predicted, predicted_reach: the surrogate's S and the half-width of its 90 % interval.
        errors: what both readers make of it.
        counts, counts_se: rendered colors ``(bend, site, facet, 3)`` in camera counts.
        predicted_counts: the surrogate's, same axes.
        metric, metric_se: rendered M of eq. (4.6), ``(bend, site)``.
        converged: whether the renders of its light have.
    """

    __pydantic_config__: ClassVar[ConfigDict] = _CONFIG

    key: str
    design: Design
    rating: Rating
    se: StandardError
    gain: float | None
    gain_se: StandardError | None
    predicted: float
    predicted_reach: StandardError
    errors: dict[ReaderName, RenderedFigure]
    counts: Array
    counts_se: Array
    predicted_counts: Array
    metric: Array
    metric_se: Array
    converged: bool = True

    @property
    def title(self) -> str:
        """What it is called."""
        return TITLES[self.key]

    @property
    def error_map(self) -> None:
        """Readers' degrees by site: noise of renders would be part of them."""

    @property
    def score(self) -> float:
        """S of eq. (4.7)."""
        return self.rating.score

    def figure(self, objective: ObjectiveName) -> RenderedFigure:
        """Return what ``objective`` says of it."""
        if objective != "score":
            return self.errors[objective]
        return RenderedFigure(self.score, self.se, self.gain, self.gain_se, self.predicted)

    @property
    def prediction_check(self) -> IntervalCheck:
        """What the renders say of the surrogate's 90 % interval."""
        error = self.predicted - self.score
        return check_interval(error, self.predicted_reach, self.se, converged=self.converged)

    @property
    def clipped(self) -> float:
        """Fraction of rendered facets that saturate the camera."""
        return float(clipped_fraction(self.counts))


_FIGURES = ("key", "se", "gain", "gain_se", "predicted", "predicted_reach", "converged")
_SHARED = ("objective", "replicates", "winner", "verdict")
_MEASURED = ("trade", "facts")


@dataclass(frozen=True)
class ConvergencePoint:
    """One design that was rendered on the way.

    Arguments:
        step: when: a round, or the final verification.
        role: why it was rendered (``baseline``, ``best``, ``uncertain``, ``random``, ...).
        value, se: the objective's, rendered; predicted: by the surrogate of that time.
    """

    __pydantic_config__: ClassVar[ConfigDict] = _CONFIG

    step: str
    role: str
    value: float
    se: StandardError
    predicted: float


@dataclass(frozen=True, eq=False)
class OvernightResult:
    """Everything that the report of a night shows.

    Arguments:
        scene: the sensor.
        objective: what decided.
        replicates: independent replicates behind every standard error.
        finalists: the baseline first.
        winner: key of the design that is handed over; the baseline's, if nothing beat it.
        verdict: sentences with their statistics, the most important first.
        steps: what was rendered on the way, in order.
        trade: speed and accuracy by level: its name, seconds per design, median and 95th percentile
            of the error of facet colors, median error of S, Kendall's tau.
        facts: versions, hashes, seeds, budget and seconds spent, in the order shown.
    """

    __pydantic_config__: ClassVar[ConfigDict] = _CONFIG

    scene: Scene
    objective: ObjectiveName
    replicates: Annotated[int, Field(ge=2)]
    finalists: tuple[Finalist, ...]
    winner: str
    verdict: tuple[str, ...]
    steps: tuple[ConvergencePoint, ...]
    trade: tuple[tuple[str, float, float, float, float, float], ...]
    facts: tuple[tuple[str, str], ...]

    @property
    def best(self) -> Finalist:
        """The finalist that is handed over."""
        return next(entry for entry in self.finalists if entry.key == self.winner)

    @property
    def settings(self) -> ScoreSettings:
        """Exposure, lambda and conventions of every score here."""
        return self.finalists[0].rating.settings

    @property
    def interval_factor(self) -> float:
        """Standard errors on either side of a value that make its 95 % interval (Student's t)."""
        return student_factor(self.replicates)

    def save(self, run: Path) -> None:
        """Write ``night.npz`` and the other files of the night into ``run``, each atomically.

        Equal nights make equal bytes but for those of ``measured.json``.

        Raises:
            DesignError: a number that is not finite.
        """
        for entry in self.finalists:
            path = run / DESIGNS / f"{entry.key}.json"
            save_design(path, entry.design, self.scene, entry.rating)
        write_json(run / MEASURED, {name: getattr(self, name) for name in _MEASURED})
        content = {name: getattr(self, name) for name in _SHARED} | {
            "schema": SCHEMA,
            "scene_hash": self.scene.hash,
            "steps": [asdict(step) for step in self.steps],
            "finalists": [
                {name: getattr(e, name) for name in _FIGURES}
                | {"rating": asdict(e.rating)}
                | {"errors": {name: asdict(figure) for name, figure in e.errors.items()}}
                for e in self.finalists
            ],
        }
        parts = [
            vars(entry) | {"phi": entry.design.phi, "power": entry.design.drive}
            for entry in self.finalists
        ]
        arrays = {name: np.stack([part[name] for part in parts]) for name in _shapes(self.scene)}
        write_npz(run / NIGHT, arrays | {"night": np.array(json.dumps(content, allow_nan=False))})

    @classmethod
    def load(cls, run: Path) -> OvernightResult:
        """Return the night in ``run``.

        Raises:
            RunError: says in one sentence what is missing, damaged or foreign.
        """
        path = run / NIGHT
        try:
            scene, arrays = load_scene(run / SCENE), read_npz(path)
            content = parse_json(str(arrays.pop("night"))) | read_sealed(run / MEASURED)
            if (content.pop("schema"), content.pop("scene_hash")) != (SCHEMA, scene.hash):
                raise ValueError(f"it is of another version, or of another scene than {SCENE}")
            keys = [entry["key"] for entry in content["finalists"]]
            known = len(set(keys) & set(TITLES)) == len(keys) and content["winner"] in keys
            if not known or keys[0] != "baseline":
                raise ValueError(f"its finalists are {keys}, its winner {content['winner']}")
            for name, shape in _shapes(scene).items():
                array, wanted = arrays[name], (len(keys), *shape)
                if array.dtype != float or array.shape != wanted or not np.isfinite(array).all():
                    raise ValueError(f"{name} is not finite float64 of shape {wanted}")
            for index, entry in enumerate(content["finalists"]):
                entry |= {name: array[index] for name, array in arrays.items()}
                entry["design"] = Design(entry.pop("phi"), entry.pop("power"), scene.palette)
            return _validated({"scene": scene, **content})
        except (OSError, TactiluxError, KeyError, TypeError, AttributeError, ValueError) as error:
            raise RunError(
                f"{path} is no finished night ({' '.join(str(error).split())}): a report needs a "
                "night that has come to its end and is whole, go on with tactilux overnight, which "
                "writes it anew from the renders",
                field="run",
            ) from None


def _shapes(scene: Scene) -> dict[str, tuple[int, ...]]:
    """Return the shape of every array of a finalist."""
    fibers = scene.lamp_count
    sites = (len(scene.state_axis), len(counted_sites(scene)))
    colors, channels = scene.palette.matrix.shape
    cells = (*sites, scene.indenter.faces, channels)
    seen = dict.fromkeys(("counts", "counts_se", "predicted_counts"), cells)
    lights = {"phi": (fibers,), "power": (fibers, colors)}
    return {**lights, **seen, "metric": sites, "metric_se": sites}


_RESULT = TypeAdapter(OvernightResult)


def _validated(content: dict[str, object]) -> OvernightResult:
    try:
        return _RESULT.validate_python(content)
    except ValidationError as error:
        raise ValueError(problem_sentence(error.errors(include_url=False)[0])) from None
