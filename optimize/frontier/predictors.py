"""What predicts designs before they are rendered: previews, the shipped model, few renders.

Each is made as a user's first command makes it, and timed: with a cache of its own, so that a scene
that was explored before does not look quicker than it is.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from optimize.design import ScoreSettings
from render.choose_exposure import scene_scale
from render.errors import RenderError, SceneError, TableError
from render.files import read_json, write_json
from render.levels import (
    CONVERGED,
    FEW_PATHS,
    FEW_RENDERS,
    PREVIEW,
    SURROGATE,
    TABLE,
    Effort,
    level_name,
    level_of,
    read_level,
)
from render.progress import OnProgress, in_stage
from render.scene import Scene
from render.transport import TransportTable, load_table
from surrogate.preview_model import few_paths_checker, preview_checker
from surrogate.runtime import Checker, rendering_seconds

if TYPE_CHECKING:  # torch comes with it
    from surrogate.train import TrainConfig

SETUP, CACHE, FEW, TABLE_FILE = "setup.json", "cache", "few", "reference.npz"
SHIPPED = "checker.onnx"
TRACED = level_name(SURROGATE, FEW_PATHS), level_name(SURROGATE, CONVERGED)
LEARNED, SUPERPOSED = level_name(SURROGATE, FEW_RENDERS), level_name(SURROGATE, TABLE)
"""Few renders: what they teach, and themselves."""
SCALE_TOLERANCE = 1e-2
"""Relative difference of exposure or lambda from which scores are on another scale.

A model keeps that of the preview it was trained on. A later preview may move lambda by half a
percent, and a score by half of that.
"""


@dataclass(frozen=True)
class Predictor:
    """What answers at once after ``seconds`` of set-up, with its stated effort."""

    name: str
    checker: Checker
    seconds: float
    effort: Effort | None = None


@dataclass
class Predictors:
    """All of a scene, from quick to slow, on one scale.

    Arguments:
        settings: exposure and lambda.
        found: the levels that the scene has.
        table: the renders behind `LEARNED`, and their seconds, if there are any.
        left_out: why the scene lacks one, by its name.
    """

    settings: ScoreSettings
    found: list[Predictor] = field(default_factory=list)
    table: tuple[TransportTable, float] | None = None
    left_out: dict[str, str] = field(default_factory=dict)


def make_predictors(
    scene: Scene,
    shipped: Checker | None,
    folder: Path,
    seed: int,
    config: TrainConfig,
    report: OnProgress,
) -> Predictors:
    """Make every level of ``scene``; what is finished is kept in ``folder`` with its seconds.

    Arguments:
        scene: the sensor.
        shipped: its trained model, None where it has none.
        folder: for caches, the model of few renders, and `SETUP`.
        seed: of the training.
        config: of the model of few renders.
        report: is told how far it is.

    Raises:
        GraphicsError: no OpenGL library can draw.
    """
    setup = _Setup(folder, scene)
    if not set(TRACED) <= setup.seconds.keys():
        shutil.rmtree(folder / CACHE, ignore_errors=True)
    with _own_cache(folder / CACHE):
        levels = Predictors(ScoreSettings(1.0, 0.0))
        previews: dict[Effort | None, Callable[[], Checker]] = {}
        if scene.window_refracts:
            levels.left_out[PREVIEW] = "the shader lacks the light that a window guides"
        else:
            previews[None] = lambda: preview_checker(scene, report, coarse=True)
        previews[FEW_PATHS] = lambda: few_paths_checker(scene, report)
        previews[CONVERGED] = lambda: preview_checker(scene, report)
        seconds = 0.0
        for effort, make in previews.items():
            # One after the other, as `tactilux explore` has them.
            made = setup.timed(level_name(level_of(effort), effort), make)
            seconds += made.seconds
            levels.found.append(replace(made, seconds=seconds, effort=effort))
        scale = scene_scale(scene)
        levels.settings = ScoreSettings(scale.exposure, scale.lam)
        try:
            few = _few_renders(setup, seed, config, report)
        except (RenderError, SceneError, TableError) as error:
            levels.left_out |= {LEARNED: str(error), SUPERPOSED: str(error)}
        else:
            tracing = setup.seconds.get(TRACED[-1], 0.0)
            levels.found.append(replace(few, seconds=tracing + few.seconds))
            _take_table(levels, scene, folder, few.checker)
    _take_shipped(levels, scene, shipped)
    return levels


def _take_table(levels: Predictors, scene: Scene, folder: Path, few: Checker) -> None:
    """Add the renders of the model of few renders, as they are; ranges of material have many."""
    if scene.free is not None:
        levels.left_out[SUPERPOSED] = "the scene leaves its material free, and a table knows one"
        return
    table = load_table(folder / f"{FEW}-training" / TABLE_FILE)
    levels.table = table, _rendering(few)


def _take_shipped(levels: Predictors, scene: Scene, shipped: Checker | None) -> None:
    if shipped is None:
        levels.left_out[SHIPPED] = f"no model was trained of {scene.name}, hash {scene.hash}"
        return
    own = np.array([shipped.exposure, shipped.lam])
    scale = np.array([levels.settings.exposure, levels.settings.lam])
    if not np.allclose(own, scale, rtol=SCALE_TOLERANCE):
        levels.left_out[SHIPPED] = "its scores are on the scale of another material"
        return
    levels.found.append(Predictor(SHIPPED, shipped, _rendering(shipped), shipped.effort))


def _rendering(checker: Checker) -> float:
    """Return the seconds that a model was rendered for, 0 where nobody knows."""
    return 0.0 if checker.file is None else rendering_seconds(checker.file) or 0.0


def _few_renders(setup: _Setup, seed: int, config: TrainConfig, report: OnProgress) -> Predictor:
    """Train on few renders, or take the model that the same request made last."""
    from surrogate.train import train

    folder = setup.folder / FEW
    key = f"{FEW_RENDERS} {seed} {config.minutes:g} {config.samples}"

    def trained() -> Checker:
        told = in_stage(report, "training on few renders")
        train(setup.scene, folder, seed=seed, config=config, progress=told)
        return Checker.for_scene(folder, setup.scene)

    if setup.few == key:
        kept = Checker.for_scene(folder, setup.scene)
        return Predictor(LEARNED, kept, setup.seconds[key], FEW_RENDERS)
    # One that is cut off may leave the model of one request beside the renders of another.
    setup.few_is_of("")
    made = setup.timed(key, trained)
    setup.few_is_of(key)
    return replace(made, name=LEARNED, effort=FEW_RENDERS)


class _Setup:
    """Seconds until predictors were ready, kept in a folder: of the first time, without caches.

    ``few`` is the request whose model and renders lie in the folder `FEW`, empty where none do.
    """

    def __init__(self, folder: Path, scene: Scene) -> None:
        self.folder, self.scene, self.seconds = folder, scene, dict[str, float]()
        self.few = ""
        kept = read_json(folder / SETUP)
        if kept.pop("scene_hash", None) == scene.hash:
            self.few = str(kept.pop(FEW, ""))
            names = {key: level_name(*read_level(key)) for key in kept}
            self.seconds = {names[key]: float(str(value)) for key, value in kept.items()}
        else:
            self._write()

    def few_is_of(self, key: str) -> None:
        """Remember whose training the folder `FEW` holds."""
        self.few = key
        self._write()

    def timed(self, name: str, make: Callable[[], Checker]) -> Predictor:
        """Return what ``make`` makes, with the seconds that it took the first time."""
        began = time.perf_counter()
        checker = make()
        if name not in self.seconds:
            self.seconds[name] = time.perf_counter() - began
            self._write()
        return Predictor(name, checker, self.seconds[name])

    def _write(self) -> None:
        about = {"scene_hash": self.scene.hash, FEW: self.few}
        write_json(self.folder / SETUP, about | self.seconds)


@contextmanager
def _own_cache(folder: Path) -> Iterator[None]:
    """Let `render.preview.diffuser.cache.cache_folder` be in ``folder``."""
    before = os.environ.get("XDG_CACHE_HOME")
    os.environ["XDG_CACHE_HOME"] = str(folder.resolve())
    try:
        yield
    finally:
        if before is None:
            del os.environ["XDG_CACHE_HOME"]
        else:
            os.environ["XDG_CACHE_HOME"] = before
