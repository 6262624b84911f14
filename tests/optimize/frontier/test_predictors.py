"""Levels that answer at once are held against the reference on one scale."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from optimize.frontier.predictors import FEW, LEARNED, SCALE_TOLERANCE, SETUP, _few_renders, _Setup
from render.choose_exposure import scene_scale
from render.files import write_json
from render.scene import Scene, load_scene, shipped_scenes
from surrogate.runtime import Checker
from surrogate.train import TrainConfig

MODELS = Path(__file__).parents[3] / "models"


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_scenes())
def test_shipped_models_are_on_the_scale_of_their_scenes_preview(name: str) -> None:
    """A preview that changes by more than that asks for the models to be made again."""
    model, scale = Checker.load(MODELS / name), scene_scale(load_scene(name))
    np.testing.assert_allclose(
        [model.exposure, model.lam], [scale.exposure, scale.lam], rtol=SCALE_TOLERANCE
    )


class Killed(BaseException):
    """The process was killed, as far as a frontier can tell."""


@pytest.fixture
def trainings(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return what is trained, in order; a model is a file that says its request."""
    done: list[str] = []

    def train(scene: Scene, out: Path, *, seed: int, config: TrainConfig, progress: object) -> None:
        if seed < 0:
            raise Killed
        done.append(f"seed {seed} minutes {config.minutes:g}")
        out.mkdir(parents=True, exist_ok=True)
        (out / "request").write_text(done[-1])

    def opened(folder: Path, scene: Scene) -> Any:
        return SimpleNamespace(request=(folder / "request").read_text())

    monkeypatch.setattr("surrogate.train.train", train)
    monkeypatch.setattr(Checker, "for_scene", opened)
    return done


def few_renders(folder: Path, seed: int, minutes: float) -> tuple[str, float]:
    """Return whose model a command reports as few renders, and its seconds."""
    config = TrainConfig(minutes=minutes)
    made = _few_renders(_Setup(folder, load_scene("finger20")), seed, config, lambda _: None)
    assert (made.name, made.effort) == (LEARNED, "few renders")
    return str(getattr(made.checker, "request")), made.seconds  # noqa: B009


def test_few_renders_are_those_of_the_request_whatever_was_asked_before(
    trainings: list[str], tmp_path: Path
) -> None:
    first = few_renders(tmp_path, 0, 2.5)
    for seed, minutes in ((1, 2.5), (0, 2.5), (0, 5.0), (0, 2.5)):
        model, seconds = few_renders(tmp_path, seed, minutes)
        assert model == f"seed {seed} minutes {minutes:g}"
        # What goes on from kept renders is no measure of what they take.
        assert seconds == first[1] or (seed, minutes) != (0, 2.5)
    assert len(trainings) == 5
    few_renders(tmp_path, 0, 2.5)
    assert len(trainings) == 5


def test_seconds_that_were_kept_by_names_of_before_are_found(tmp_path: Path) -> None:
    scene = load_scene("finger20")
    before = {"preview": 5.0, "preview of few paths": 12.0, "converged preview": 80.0}
    write_json(tmp_path / SETUP, {"scene_hash": scene.hash, FEW: ""} | before)
    names = ("preview", "surrogate (few paths)", "surrogate (converged)")
    assert _Setup(tmp_path, scene).seconds == dict(zip(names, before.values(), strict=True))


def test_a_training_that_was_cut_off_leaves_nobodys_few_renders(
    trainings: list[str], tmp_path: Path
) -> None:
    few_renders(tmp_path, 0, 2.5)
    (tmp_path / FEW / "request").write_text("of another")
    with pytest.raises(Killed):
        few_renders(tmp_path, -1, 2.5)
    assert few_renders(tmp_path, 0, 2.5)[0] == "seed 0 minutes 2.5"
    assert len(trainings) == 2
