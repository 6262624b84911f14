"""The model of a scene that nobody trained: its preview, superposed in numpy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from render.metric import design_score, image_counts, site_metric
from render.preview import Preview
from render.scale import ScoreScale, scene_scale
from render.scene import Scene
from surrogate.model.checker_module import CheckerModule
from surrogate.model.facet_basis import SIZE
from surrogate.model.networks import NoResidual
from surrogate.model.preview_grid import PreviewGrid, draw_grid
from surrogate.preview_model import PHI_NODES, PreviewSession, preview_checker
from surrogate.runtime import Checker, RankingTest
from surrogate.runtime.model_file import OUTPUTS
from tests.surrogate.conftest import small_scene


@pytest.fixture(scope="module")
def sensor() -> Scene:
    """A clear flat pad: drawn in a second."""
    scene = small_scene(bending={"angles": {"value": [0.0], "unit": "deg", "source": "flat"}})
    return scene.model_copy(update={"diffuser": None})


@pytest.fixture(scope="module")
def checker(sensor: Scene, tmp_path_factory: pytest.TempPathFactory) -> Checker:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        return preview_checker(sensor)


def designs(scene: Scene, count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    fibers = scene.lamp_count
    phi = rng.uniform(0.0, np.pi, (count, fibers))
    return phi, np.eye(3)[rng.integers(0, 3, (count, fibers))]


def test_it_says_of_a_design_what_the_preview_shows(sensor: Scene, checker: Checker) -> None:
    phi, power = designs(sensor, 1)
    bends = np.array(sensor.bending.angles)
    said = checker.run(phi, power, bends)
    with Preview(sensor) as preview:
        light, untouched = preview.transport(phi[0][:, None], bends)
    scale = scene_scale(sensor)
    counts = np.asarray(image_counts(light[:, 0], power[0], scale.exposure))
    background = np.einsum("fbs,fc->bsc", untouched[:, 0], power[0]) * scale.exposure
    assert np.abs(said["counts"][0] - counts).max() < 0.02 * counts.max()
    assert np.median(np.abs(said["counts"][0] - counts)) < 0.003 * counts.max()
    assert np.abs(said["background"][0] - background).max() < 0.02 * background.max()
    score = float(design_score(site_metric(counts, scale.lam)).score)
    assert said["score"][0] == pytest.approx(score, abs=0.5)
    assert checker.level == "preview"
    ranking = RankingTest.of(checker.metadata)
    assert ranking.reliable or "train a model" in ranking.advice()


def test_it_equals_the_exported_graph_without_a_residual(sensor: Scene, checker: Checker) -> None:
    grid = draw_grid(sensor, PHI_NODES, 1)
    nothing = NoResidual(SIZE)
    graph = CheckerModule(
        sensor, grid, nothing, exposure=checker.exposure, lam=checker.lam, spread=(0.0, 0.0)
    )
    phi, power = designs(sensor, 5)
    bends = np.array(sensor.bending.angles)
    said = checker.run(phi, power, bends)
    feeds = (phi, power, np.tile(bends, (5, 1)))
    with torch.no_grad():
        expected = graph(*(torch.as_tensor(x, dtype=torch.float32) for x in feeds))
    for name in OUTPUTS:
        if name != "counts_spread":
            wanted = getattr(expected, name).numpy()
            assert np.abs(said[name] - wanted).max() < 1e-3 * max(np.abs(wanted).max(), 1.0), name


def test_beyond_the_bends_of_the_scene_it_is_an_extrapolation(checker: Checker) -> None:
    fibers = checker.metadata.fibers
    asked = np.full((1, fibers), 1.0), np.ones((1, fibers, 3))
    assert checker.run(*asked, np.array([0.0]))["domain_excess"][0] == 0.0
    assert checker.run(*asked, np.array([0.5]))["domain_excess"][0] == pytest.approx(0.5)


def test_the_scenes_own_bends_are_inside_though_float32_rounds_them_up() -> None:
    last = np.radians(45.0)
    grid = PreviewGrid(np.zeros((1, 1, 2, 1, 4)), np.array([1.0]), np.array([0.0, last]), 0)
    session = PreviewSession(grid, ScoreScale(1.0, 1.0))
    rounded = np.float64(np.float32(last))
    assert rounded > last
    said = session.outputs(np.ones((1, 1)), np.ones((1, 1, 3)), np.array([0.0, rounded]))
    assert said["domain_excess"] == 0.0


def test_what_was_drawn_is_kept_and_a_damaged_file_is_drawn_again(
    sensor: Scene, checker: Checker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    phi, power = designs(sensor, 1)
    asked = phi, power, np.array(sensor.bending.angles)
    told: list[object] = []
    first = preview_checker(sensor, told.append).run(*asked)
    assert len(told) == 1
    again = preview_checker(sensor, told.append).run(*asked)
    assert len(told) == 1
    (file,) = (tmp_path / "tactilux").glob("preview-*.npz")
    file.write_bytes(b"damaged")
    mended = preview_checker(sensor).run(*asked)
    for name in OUTPUTS:
        assert np.array_equal(first[name], again[name])
        assert np.array_equal(first[name], mended[name])
