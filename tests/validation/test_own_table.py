"""A sensor whose preview cannot converge answers from a table of renders that nobody asked for."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import optimize.scoring.surrogate_model as models
from optimize.design import baseline_design
from optimize.scoring import find_model, is_prompt, open_model, predict_design
from render.metric import image_counts
from render.reference import render_transport
from render.scene import Scene, load_scene
from surrogate.runtime.metadata import TABLE

SAMPLES = 2000
MINUTES = 1.0


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Return a dome that no shipped model knows."""
    dome = load_scene("digit-dome")
    assert dome.skin is not None
    skin = dome.skin.model_copy(update={"radius": 40.0})
    return Scene.model_validate(dome.model_copy(update={"skin": skin, "name": "unknown"}))


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        patch.setattr(models, "TABLE_MINUTES", MINUTES)
        yield


def test_a_sensor_without_a_model_is_answered_by_a_table_of_its_own(scene: Scene) -> None:
    assert find_model(scene) is None
    assert not is_prompt(scene)
    checker = open_model(scene)
    assert checker.metadata.residual["kind"] == TABLE
    # What was rendered once is there at once, and damaged files are rendered again.
    folder = find_model(scene)
    assert folder is not None
    assert is_prompt(scene)

    design, bends = baseline_design(scene), np.zeros(1)
    said = predict_design(checker, design, bends)
    other = render_transport(scene, design.phi[:, None], bends, samples=SAMPLES, seeds=[77])
    light, error = other.T[:, 0], other.se[:, 0]
    found = np.asarray(image_counts(light, design.power, checker.exposure))
    noise = checker.exposure * np.sqrt(np.einsum("fc,fbsk->bskc", design.power**2, error**2))
    half = checker.counts_factor * np.hypot(said["counts_spread"], noise)
    lit = said["counts_spread"] > 0.0
    assert (np.abs(said["counts"] - found) <= half)[lit].mean() >= 0.8


def test_a_table_that_was_damaged_is_no_model(scene: Scene) -> None:
    folder = find_model(scene)
    assert folder is not None
    file: Path = folder / "checker.onnx"
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    assert find_model(scene) is None
    file.write_bytes(whole)
    assert find_model(scene) == folder
