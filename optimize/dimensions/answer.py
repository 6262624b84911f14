"""What the engine answers about one sensor: errors of its baseline and of its best lights."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from optimize.design import Array, Design
from optimize.exploration import Stage, explore
from optimize.objectives import READERS, ReaderName
from optimize.readers import CameraModel, reading
from optimize.scoring import predicted_colors
from optimize.ui.provenance import program_version
from render.progress import OnProgress
from render.scene import Scene
from render.scene.scene_file import written_of
from surrogate.preview_model import few_paths_checker, preview_checker
from surrogate.runtime import Checker

StudyEffort = Literal["drawn", "few", "converged"]
"""The preview as the shader draws it, or with traced light of few or of all paths."""
EFFORT_NAMES: dict[StudyEffort, str] = {
    "drawn": "preview", "few": "few paths", "converged": "converged",
}  # fmt: skip
"""What people call them."""
FORMAT = 2
"""Part of the name of a kept answer: raise it when answers mean something else."""
NOISE_DRAWS, NOISE_SEED = 2, 73
"""Draws of the photon noise that is added to colors, the same for all sensors."""
LEAST_LEFT = 0.5
"""Part of an error at least that is not photon noise."""
EXPOSURE_LIMITS = 0.01, 1000.0
"""Longest exposures that a scene file may state."""


@dataclass(frozen=True, eq=False)
class LightErrors:
    """Errors of both readers with some lights, and how bright they are.

    Arguments:
        sensor, place: degrees on the model's colors, ``(draw,)``.
        noisier: the same with the photon noise of these colors added once more, by reader; nothing
            where no light was traced.
        exposure: exposure time in counts per 1/(mm^2 sr): how dark the sensor is.
        score: S in counts.
    """

    sensor: Array
    place: Array
    noisier: Mapping[ReaderName, Array]
    exposure: float
    score: float

    @classmethod
    def of(cls, checker: Checker, stage: Stage) -> LightErrors:
        """Return what a model and a stage that it rated say."""
        read, noise, noisier = stage.reading, checker.photon_noise, {}
        if noise:
            colors = predicted_colors(checker, stage.design)
            rng = np.random.default_rng(NOISE_SEED)
            spread = 1.0 + noise * rng.standard_normal((NOISE_DRAWS, *colors.shape))
            found = [reading(stage.scene, colors * factor) for factor in spread]
            for reader in READERS:
                means = [getattr(one, reader).means for one in found]
                noisier[reader] = np.sqrt(np.mean(np.square(means), axis=0))
        exposure = checker.exposure * read.factor / read.gain
        return cls(read.sensor.means, read.place.means, noisier, exposure, stage.rating.score)

    def mean(self, reader: ReaderName) -> float:
        """Return the mean error of a reader in degrees, as it were without photon noise.

        Noise of the model looks like skin to a reader: squares of errors grow with the variance of
        it. So the square is extrapolated from that with once and with twice the variance to none:
        simulation-extrapolation (Cook and Stefanski 1994).
        """
        found = self.measured(reader)
        if reader not in self.noisier:
            return found
        square = 2.0 * found**2 - float(np.mean(self.noisier[reader])) ** 2
        return math.sqrt(min(max(square, (LEAST_LEFT * found) ** 2), found**2))

    def measured(self, reader: ReaderName) -> float:
        """Return the mean error of a reader in degrees, photon noise included."""
        return float(getattr(self, reader).mean())

    def to_json(self) -> dict[str, Any]:
        """Return what `from_json` reads."""
        draws = {reader: getattr(self, reader).tolist() for reader in READERS}
        noisier = {reader: draw.tolist() for reader, draw in self.noisier.items()}
        return draws | {"noisier": noisier, "exposure": self.exposure, "score": self.score}

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> LightErrors:
        """Return what `to_json` wrote.

        Raises:
            KeyError, TypeError, ValueError: it is something else.
        """
        draws = {reader: np.array(content[reader], dtype=np.float64) for reader in READERS}
        noisier = {
            reader: np.array(content["noisier"][reader], dtype=np.float64)
            for reader in READERS
            if reader in content["noisier"]
        }
        if any(draw.ndim != 1 or len(draw) < 2 for draw in (*draws.values(), *noisier.values())):
            raise ValueError("draws are missing")
        return cls(
            sensor=draws["sensor"],
            place=draws["place"],
            noisier=noisier,
            exposure=float(content["exposure"]),
            score=float(content["score"]),
        )


@dataclass(frozen=True, eq=False)
class Answer:
    """What one effort says about one sensor.

    Arguments:
        effort: that answers.
        baseline: with its baseline lights.
        best: with the best lights found for it.
        design: those.
        proven: how many designs are allowed, where that is proven to be the best of them.
        scene_exposure: counts per 1/(mm^2 sr) at the scene's own exposure.
        photon_noise: of facet colors, relative, where light was traced.
        seconds: that it took.
    """

    effort: StudyEffort
    baseline: LightErrors
    best: LightErrors
    design: Design
    proven: int | None
    scene_exposure: float
    photon_noise: float | None
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Return what `from_json` reads: the same numbers, bit by bit."""
        return {
            "effort": self.effort,
            "baseline": self.baseline.to_json(),
            "best": self.best.to_json(),
            "phi": self.design.phi.tolist(),
            "drive": self.design.drive.tolist(),
            "proven": self.proven,
            "scene_exposure": self.scene_exposure,
            "photon_noise": self.photon_noise,
            "seconds": self.seconds,
        }

    @classmethod
    def from_json(cls, content: Mapping[str, Any], scene: Scene) -> Answer:
        """Return what `to_json` wrote about ``scene``.

        Raises:
            KeyError, TypeError, ValueError: it is something else.
        """
        noise = content["photon_noise"]
        return cls(
            content["effort"],
            LightErrors.from_json(content["baseline"]),
            LightErrors.from_json(content["best"]),
            Design(np.array(content["phi"]), np.array(content["drive"]), scene.palette),
            None if content["proven"] is None else int(content["proven"]),
            float(content["scene_exposure"]),
            None if noise is None else float(noise),
            float(content["seconds"]),
        )


def model_at(scene: Scene, effort: StudyEffort, progress: OnProgress | None = None) -> Checker:
    """Return what answers about ``scene`` at an effort; trained models take no part.

    Sensors are held against each other, so that all have the same kind of model.
    """
    if effort == "few":
        return few_paths_checker(scene, progress)
    return preview_checker(scene, progress, coarse=effort == "drawn")


def answer(
    scene: Scene,
    effort: StudyEffort,
    reader: ReaderName,
    seed: int,
    present_exposure: float | None = None,
    progress: OnProgress | None = None,
) -> Answer:
    """Return what ``effort`` says about ``scene`` and its best lights for a ``reader``.

    Arguments:
        scene: the sensor.
        effort: of the model.
        reader: whose degrees the search for lights lowers.
        seed: of that search; light, normals and noise are drawn alike for all sensors.
        present_exposure: `Answer.scene_exposure` of the sensor that this one is held against: the
            camera exposes no longer. None for that sensor itself.
        progress: told how far the model is.
    """
    began = time.monotonic()
    checker = model_at(scene, effort, progress)
    scene = exposed_like(scene, checker.exposure, present_exposure)
    found = explore(scene, checker, objective=reader, seed=seed)
    first, last = found.stages[0], found.stages[-1]
    baseline = LightErrors.of(checker, first)
    kept = all(
        np.array_equal(getattr(first.design, name), getattr(last.design, name))
        for name in ("phi", "drive")
    )
    return Answer(
        effort,
        baseline,
        baseline if kept else LightErrors.of(checker, last),
        last.design,
        found.proven,
        checker.exposure,
        checker.photon_noise,
        round(time.monotonic() - began, 3),
    )


def exposed_like(scene: Scene, exposure: float, present: float | None) -> Scene:
    """Return ``scene`` with the longest exposure time of the present sensor, not in its own units.

    A scene's own exposure is what makes its baseline bright; its camera may expose some times as
    long. A darker sensor would otherwise be granted more time and no noise for it.
    """
    if present is None:
        return scene
    longest = CameraModel.of(scene).longest_exposure * present / exposure
    longest = min(max(longest, EXPOSURE_LIMITS[0]), EXPOSURE_LIMITS[1])
    source = "as long as the sensor that the study began with, in units of this one's exposure"
    return scene.with_(
        schema=2, **{"camera.longest_exposure": {"value": longest, "source": source}}
    )


def answer_key(
    scene: Scene, effort: StudyEffort, reader: ReaderName, seed: int, present: float | None
) -> str:
    """Return 16 hex digits of all that an answer depends on; sources and names have no part."""
    content = {name: part for name, part in written_of(scene).content.items() if name != "name"}
    asked = [scene.hash, _without_sources(content), effort, reader, seed, present]
    about = json.dumps([*asked, FORMAT, program_version()], sort_keys=True, default=str)
    return hashlib.sha256(about.encode()).hexdigest()[:16]


def _without_sources(part: Any) -> Any:
    if isinstance(part, Mapping):
        return {name: _without_sources(one) for name, one in part.items() if name != "source"}
    if isinstance(part, list):
        return [_without_sources(one) for one in part]
    return part
