"""The model of a scene that nobody trained: its preview, superposed in numpy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from render.chebyshev import chebyshev_nodes
from render.choose_exposure import ScoreScale, baseline_power, scene_scale
from render.metric import design_score, image_counts, site_metric
from render.preview import Preview
from render.preview.converged import (
    ConvergedTransport,
    Effort,
    cache,
    few_paths_transport,
    is_kept,
    phi_nodes,
    task_count,
    transport_at,
)
from render.progress import Clock, Progress
from render.scene import Scene, unchecked
from surrogate.model.checker_module import CheckerModule
from surrogate.model.facet_basis import SIZE
from surrogate.model.networks import NoResidual
from surrogate.model.preview_grid import PreviewGrid, draw_grid
from surrogate.preview_interval import (
    DRAWN_FRACTION,
    Scores,
    followed_half_width,
    preview_difference,
)
from surrogate.preview_model import (
    PHI_NODES,
    PreviewSession,
    corrected,
    few_paths_checker,
    preview_checker,
)
from surrogate.runtime import Checker, RankingTest
from surrogate.runtime.model_file import OUTPUTS
from tests.oracles.pads import content_of_case
from tests.oracles.random_scenes import random_content
from tests.small_scenes import small_scene

NODES = chebyshev_nodes(13, 0.0, np.pi)


@pytest.fixture(scope="module")
def sensor() -> Scene:
    """A clear flat pad: drawn in a second."""
    scene = small_scene(bending={"angles": {"value": [0.0], "unit": "deg", "source": "flat"}})
    return unchecked(scene, {"diffuser": None})


@pytest.fixture(scope="module")
def checker(sensor: Scene, tmp_path_factory: pytest.TempPathFactory) -> Checker:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        return preview_checker(sensor, coarse=True)


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
    session = PreviewSession(small_scene(), grid, ScoreScale(1.0, 1.0), 0.1)
    rounded = np.float64(np.float32(last))
    assert rounded > last
    said = session.outputs(np.ones((1, 1)), np.ones((1, 1, 3)), np.array([0.0, rounded]))
    assert said["domain_excess"] == 0.0


@pytest.mark.slow
def test_what_was_drawn_is_kept_and_a_damaged_file_is_drawn_again(
    sensor: Scene, checker: Checker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    phi, power = designs(sensor, 1)
    asked = phi, power, np.array(sensor.bending.angles)
    told: list[object] = []
    first = preview_checker(sensor, told.append, coarse=True).run(*asked)
    assert len(told) == 1
    again = preview_checker(sensor, told.append, coarse=True).run(*asked)
    assert len(told) == 1
    (file,) = (tmp_path / "tactilux").glob("preview-*.npz")
    file.write_bytes(b"damaged")
    mended = preview_checker(sensor, coarse=True).run(*asked)
    for name in OUTPUTS:
        assert np.array_equal(first[name], again[name])
        assert np.array_equal(first[name], mended[name])


def found(cells: np.ndarray, grain: float) -> ConvergedTransport:
    return ConvergedTransport(cells, np.full(cells.shape[:3], grain), np.zeros(cells.shape[2]))


def shader_grid(bends: list[float]) -> PreviewGrid:
    """Return a smooth grid of 2 lamps, 2 sites and 3 facets."""
    rng = np.random.default_rng(4)
    phi, nodes = chebyshev_nodes(33, 0.0, np.pi), chebyshev_nodes(9, 0.0, max(bends))
    level = rng.uniform(-2.0, 0.0, (2, 1, 1, 2, 4))
    log = level + 0.5 * np.sin(phi)[:, None, None, None] - 0.3 * nodes[:, None, None]
    return PreviewGrid(log, phi, nodes, 0)


def bending(scene: Scene, bends: list[float]) -> Scene:
    return unchecked(scene, {"bending": unchecked(scene.bending, {"angles": tuple(bends)})})


def test_without_noise_the_corrected_grid_is_the_converged_transport(sensor: Scene) -> None:
    bends = [0.0, 0.5, 1.2]
    scene, grid = bending(sensor, bends), shader_grid(bends)
    drawn = np.exp(grid.evaluate(NODES, np.array(bends)))
    cells = drawn * (1.3 + 0.2 * np.cos(NODES)[:, None, None, None])
    better = corrected(grid, scene, found(cells, 0.0))
    at = np.exp(better.evaluate(NODES, np.array(bends)))
    np.testing.assert_allclose(at, cells, rtol=1e-9)
    between = np.array([0.7, 2.2])
    ratio = np.exp(better.evaluate(between, np.array([0.9])) - grid.evaluate(between, [0.9]))
    expected = np.broadcast_to(1.3 + 0.2 * np.cos(between)[:, None, None, None], ratio.shape)
    np.testing.assert_allclose(ratio, expected, rtol=1e-3)


def test_where_noise_drowns_it_the_shader_s_cell_stays(sensor: Scene) -> None:
    scene, grid = bending(sensor, [0.3]), shader_grid([0.3])
    scene_grid = PreviewGrid(grid.log_transport[:, :, :1], grid.phi, np.array([0.3]), 0)
    unlit = np.zeros((2, len(NODES), 1, 2, 4))
    better = corrected(scene_grid, scene, found(unlit, 1e4))
    np.testing.assert_allclose(better.log_transport, scene_grid.log_transport, atol=2e-4)
    dark = corrected(scene_grid, scene, found(unlit, 1e-6))
    assert np.isfinite(dark.log_transport).all()
    assert (dark.log_transport < scene_grid.log_transport - 3.0).all()


def test_a_lamp_s_light_is_known_where_its_cells_are_lost_in_noise(sensor: Scene) -> None:
    level = np.zeros((2, 33, 1, 60, 4))
    grid = PreviewGrid(level, chebyshev_nodes(33, 0.0, np.pi), np.array([0.3]), 0)
    noisy = np.random.default_rng(3).poisson(0.5, (2, len(NODES), 1, 60, 4))
    better = corrected(grid, bending(sensor, [0.3]), found(noisy, 1.0))
    light = np.exp(better.evaluate(NODES, np.array([0.3])))
    # The shader says 1, the truth is 0.5: single cells are 0.5 +- 0.7, a lamp's sum 0.50 +- 0.05.
    assert light.mean() == pytest.approx(0.5, abs=0.05)
    assert light.std() < 0.3


@pytest.mark.slow
def test_narrow_beams_are_as_bright_between_the_nodes_as_light_that_is_followed_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With 13 nodes the lamps of such a pad had twice their light."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    effort = Effort(paths=512, arrivals=5_000_000, rounds=1)
    monkeypatch.setattr(cache, "FEW_PATHS", effort)
    content: Any = random_content(13)
    content["fibers"]["sigma_v"]["value"] = 3.0
    scene = Scene.model_validate(content)
    nodes = phi_nodes(scene)
    assert len(nodes) > 33
    between = 0.5 * (nodes[1:] + nodes[:-1])[2:-2:3]
    checker = few_paths_checker(scene)
    assert checker.metadata.preview["phi_nodes"] == len(nodes)
    lamps, dim = scene.lamp_count, 1e-3
    said = [
        checker.run(np.full((1, lamps), phi), np.full((1, lamps, 3), dim), np.zeros(1))["counts"]
        for phi in between
    ]
    seen = np.array(said)[:, 0, 0, ..., 0].sum(axis=-1) / (dim * checker.exposure)
    light = transport_at(scene, 0.0, between, effort, Clock(1, None)).cells[..., :-1]
    followed = light.sum(axis=(0, -1))
    np.testing.assert_allclose(seen.sum(axis=1), followed.sum(axis=1), rtol=0.15)
    assert seen.sum() == pytest.approx(followed.sum(), rel=0.03)


@pytest.mark.slow
def test_under_a_window_the_coarse_preview_has_the_light_that_is_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(cache, "FEW_PATHS", Effort(paths=1024, arrivals=2_000_000, rounds=1))
    content = content_of_case("window lit at its edges")
    content["baseline"]["tip"] = "green"
    for row in content["rows"]:
        row["turns"] = False
    content["window"]["index"]["value"] = 1.6
    scene = Scene.model_validate(content)
    said = preview_checker(scene, coarse=True)
    assert (said.level, said.effort) == ("surrogate", "few paths")
    phi, dim = np.full((3, 3), np.pi / 2), 0.3 * np.eye(3)[:, :, None] * [1.0, 0.0, 0.0]
    seen = said.run(phi, dim, np.zeros(1))["counts"][..., 0].sum(axis=(1, 2, 3))
    light = few_paths_transport(scene).cells[:, len(NODES) // 2, ..., :-1].sum(axis=(1, 2, 3))
    followed = 0.3 * said.exposure * light
    with Preview(scene) as preview:
        drawn = preview.transport(np.array([np.pi / 2]), np.zeros(1))[0].sum(axis=(1, 2, 3, 4))
    np.testing.assert_allclose(seen, followed, rtol=0.1)
    assert (
        np.abs(0.3 * said.exposure * drawn / followed - 1.0) > np.abs(seen / followed - 1.0)
    ).all()


@pytest.mark.slow
def test_the_converged_preview_is_kept_bend_by_bend_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(cache, "EFFORT", Effort(photons=2000, paths=128, arrivals=20_000))
    scene = small_scene(bending={"angles": {"value": [0.0, 60.0], "unit": "deg", "source": "-"}})
    assert not is_kept(scene)

    def stop(at: Progress) -> None:
        if at.done > task_count(scene, cache.EFFORT):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cache.converged_transport(scene, stop)
    assert len(list((tmp_path / "tactilux").glob("converged-*.npz"))) == 1
    told: list[Progress] = []
    whole = cache.converged_transport(scene, told.append)
    assert told[0].done == task_count(scene, cache.EFFORT)
    assert is_kept(scene)
    (tmp_path / "tactilux").rename(tmp_path / "moved")
    np.testing.assert_array_equal(cache.converged_transport(scene).cells, whole.cells)
    checker = preview_checker(scene)
    assert (checker.level, checker.effort) == ("surrogate", "converged")
    assert checker.photon_noise == whole.noise.max() > 0.0
    assert preview_checker(scene, coarse=True).photon_noise is None
    monkeypatch.setattr(
        cache, "FEW_PATHS", Effort(photons=500, paths=128, arrivals=10_000, rounds=1)
    )
    first = few_paths_checker(scene)
    assert (first.level, first.effort) == ("surrogate", "few paths")
    assert first.photon_noise is not None
    assert first.photon_noise > checker.photon_noise
    # As wide as the two previews are apart.
    drawn, phi = preview_checker(scene, coarse=True), np.full((1, scene.lamp_count), np.pi / 2)
    power, bends = baseline_power(scene)[None], np.array(scene.bending.angles)

    def mean(model: Checker) -> float:
        return float(design_score(model.run(phi, power, bends)["metric"]).mean[0])

    assert drawn.score_half_width == pytest.approx(DRAWN_FRACTION * mean(drawn), rel=1e-5)

    def scores(model: Checker) -> Scores:
        return lambda phi, power: model.run(phi, power, bends)["score"].astype(np.float64)

    for followed in (first, checker):
        difference = preview_difference(scene, scores(drawn), scores(followed))
        noise = followed.photon_noise or 0.0
        lam = followed.metadata.lam
        expected = followed_half_width(scene, mean(followed), lam, difference, noise)
        assert followed.score_half_width == pytest.approx(expected, rel=1e-3)
