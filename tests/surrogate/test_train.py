"""Training from a reference table to a model folder."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from render.choose_exposure import scene_scale
from render.errors import ModelError, TableError
from render.geometry import counted_sites
from render.preview.converged import Effort, cache, converged_transport
from render.progress import Progress
from render.reference import TimeBudget, TransportEstimate
from render.scene import Scene, load_scene, unchecked
from render.transport import TransportTable, load_table
from surrogate.export import package
from surrogate.preview_model import preview_checker
from surrogate.runtime import Checker
from surrogate.runtime.metadata import NONE
from surrogate.runtime.model_file import MODEL_FILE
from surrogate.train import TrainConfig, Trained, _fit_time, _preview, check_model_size, train
from surrogate.training import training_preview
from surrogate.training.render_plan import (
    RenderTime,
    data_hash,
    estimate_table,
    longer_plan,
    make_plan,
    rendered_seconds,
    training_bends,
)
from surrogate.training.training_preview import TrainingPreview
from tests.disk import DURABLE, logged_disk
from tests.oracles.random_scenes import random_scene


def test_the_fitted_model_is_far_better_than_the_preview(trained: Trained) -> None:
    levels = {row.name: row for row in trained.fit.levels}
    assert levels[trained.fit.kind].facet_median < 0.2 * levels["preview"].facet_median
    assert levels[trained.fit.kind].kendall_tau > 0.9


def test_the_better_of_ridge_and_networks_is_kept(trained: Trained) -> None:
    levels = {row.name: row for row in trained.fit.levels}
    loser = {"ridge": "network", "network": "ridge"}[trained.fit.kind]
    assert levels[trained.fit.kind].facet_median < 1.2 * levels[loser].facet_median


def test_whole_positions_directions_and_bends_are_left_out_too(trained: Trained) -> None:
    names = [row.name for row in trained.fit.splits]
    assert names == ["unseen fiber position", "unseen direction", "unseen bend"]


def test_a_model_that_would_be_too_large_is_refused_before_anything_is_drawn(
    tmp_path: Path,
) -> None:
    finger = load_scene("finger20")
    sites = unchecked(finger.sites, {"columns": 7, "rows": 10, "spacing": 2.0})
    said: list[Progress] = []
    with pytest.raises(
        ModelError,
        match=r"70 sites, 10 facets and 20 lamps at 11 directions and 9 bends of its preview would "
        r"have some 64\d{5} bytes, allowed: below 5000000; give the scene fewer sites \(at most "
        r"53\) or facets$",
    ):
        train(unchecked(finger, {"sites": sites}), tmp_path / "model", progress=said.append)
    assert not said
    assert not list(tmp_path.iterdir())


def test_the_size_that_is_foretold_is_that_of_the_file(
    scene: Scene, trained: Trained, quick: TrainConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = (trained.folder / MODEL_FILE).stat().st_size
    monkeypatch.setattr(package, "LARGEST", size)
    check_model_size(scene, quick)
    # What a model says of itself takes a quarter of this small one.
    monkeypatch.setattr(package, "LARGEST", int(0.7 * size))
    with pytest.raises(ModelError, match=f"{len(counted_sites(scene))} sites"):
        check_model_size(scene, quick)


def test_intervals_hold_on_designs_of_other_cells(trained: Trained) -> None:
    assert trained.fit.coverage is not None
    assert 0.8 < trained.fit.coverage.counts < 0.97


def test_the_reference_table_is_kept_with_exposure_and_lambda(
    trained: Trained, reference: TransportTable
) -> None:
    stored = load_table(trained.folder.parent / "small-training" / "reference.npz")
    assert (stored.exposure, stored.lam) == (trained.metadata.exposure, trained.metadata.lam)
    np.testing.assert_array_equal(stored.T, reference.T)
    assert data_hash(stored) == trained.metadata.training_data_hash == data_hash(reference)


def test_the_card_names_command_seed_machine_data_and_errors(trained: Trained) -> None:
    card = (trained.folder / "checker.md").read_text()
    for text in ("`tactilux train small`", "seed: 0", "cores", trained.metadata.training_data_hash,
                 "| preview |", "| ridge |", "| network |", "| unseen bend |"):  # fmt: skip
        assert text in card


@pytest.mark.slow
def test_training_again_replaces_the_model_by_the_same_file(
    trained: Trained, scene: Scene, reference: TransportTable, quick: TrainConfig, tmp_path: Path
) -> None:
    stages: list[Progress] = []
    shutil.copytree(trained.folder, tmp_path / "again")
    (tmp_path / "again" / "checker.onnx").write_bytes(b"old")
    train(scene, tmp_path / "again", table=reference, config=quick, progress=stages.append)
    again, first = (
        (folder / "checker.onnx").read_bytes() for folder in (tmp_path / "again", trained.folder)
    )
    assert again == first
    names = list(dict.fromkeys(stage.stage for stage in stages))
    assert names[0] == "preview"
    assert names[-1] == "export"
    assert all(0 <= stage.done <= stage.total for stage in stages)


def test_a_table_of_another_scene_is_refused(
    scene: Scene, reference: TransportTable, quick: TrainConfig, tmp_path: Path
) -> None:
    with pytest.raises(TableError, match="allowed: level 'reference' of scene"):
        train(scene, tmp_path / "m", table=replace(reference, scene_hash="0" * 16), config=quick)
    assert not (tmp_path / "m").exists()


def test_training_bends_include_the_scenes_own(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene(
        bending={"angles": {"value": [0.0, 30.0, 90.0], "unit": "deg", "source": "test"}}
    )
    bends = np.degrees(training_bends(scene, 3))
    np.testing.assert_allclose(bends, [0, 30, 45, 90], atol=1e-9)


def test_a_rendered_table_knows_the_means_of_two_halves_of_its_light_paths(scene: Scene) -> None:
    rng, shape = np.random.default_rng(1), (3, 2, 2, 4)
    facets, pad = rng.uniform(1, 2, (8, *shape, 6)), rng.uniform(1, 2, (8, *shape))
    estimate = TransportEstimate(
        T=facets.mean(axis=0), se=np.ones((*shape, 6)), background=pad.mean(axis=0),
        background_se=np.ones(shape), replicates=facets, background_replicates=pad,
        seconds=1.0, settings={},
    )  # fmt: skip
    table = estimate_table(scene, np.array([1.0, 2.0]), np.array([0.7, 0.0]), estimate)
    for sign, first in ((1, 0), (-1, 1)):
        found = table.T + sign * table.half_difference[..., :-1]
        np.testing.assert_allclose(found, facets[first::2].mean(axis=0)[:, :, ::-1])
        found = table.background + sign * table.half_difference[..., -1]
        np.testing.assert_allclose(found, pad[first::2].mean(axis=0)[:, :, ::-1])


def test_an_interrupted_run_keeps_its_plan(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = logged_disk(monkeypatch)

    phi, bends = np.array([1.0, 2.0]), np.zeros(1)

    def plan(seed: int, samples: int) -> int:
        made = make_plan([scene], tmp_path, seed=seed, phi=phi, bends=bends, samples=samples)
        return made.samples

    assert plan(0, 77) == 77
    assert calls == DURABLE
    assert plan(0, 77) == 77
    assert calls == DURABLE
    assert plan(0, 50) == 50
    assert plan(1, 60) == 60


def test_time_that_networks_leave_is_rendered_and_the_longer_plan_is_kept(
    scene: Scene, tmp_path: Path
) -> None:
    def within(left: float) -> RenderTime:
        return RenderTime(TimeBudget(left, time.monotonic()), lambda: 0.0)

    phi, bends = np.array([1.0, 2.0]), np.zeros(1)
    first = make_plan([scene], tmp_path, seed=0, phi=phi, bends=bends, samples=None,
                      within=within(0.1))  # fmt: skip
    spent = rendered_seconds(tmp_path)
    assert spent > 0.0
    assert longer_plan([scene], tmp_path, first, within(0.5 * spent), None) is None
    # Renders count what they have taken before.
    longer = longer_plan([scene], tmp_path, first, within(1.5 * spent), None)
    assert longer is not None
    assert longer == replace(first, samples=longer.samples)
    assert longer.samples >= 2 * first.samples
    assert longer_plan([scene], tmp_path, first, within(0.0), None) == longer


def test_the_loaded_model_scores_the_baseline_like_its_training_data(
    trained: Trained, scene: Scene, reference: TransportTable
) -> None:
    from render.choose_exposure import baseline_power
    from render.metric import design_score, image_counts, site_metric

    checker = Checker.load(trained.folder, scene.hash)
    phi = np.full((1, scene.lamp_count), np.pi / 2)
    power = baseline_power(scene)
    found = checker.run(phi, power[None], np.array(scene.bending.angles))["score"][0]
    light = reference.at(phi[0])[:, [0, 2, 4]]
    metric = site_metric(image_counts(light, power, checker.exposure), checker.lam)
    assert found == pytest.approx(
        float(design_score(metric).score), abs=3 * checker.score_half_width
    )


def test_a_table_that_ends_before_the_scenes_bends_is_refused(
    scene: Scene, reference: TransportTable, quick: TrainConfig, tmp_path: Path
) -> None:
    short = replace(reference, bends=reference.bends / 2)
    with pytest.raises(TableError, match="spans bends 0 to 45 deg, allowed: the scene's 0 to 90"):
        train(scene, tmp_path / "m", table=short, config=quick)


@pytest.mark.slow
def test_a_model_of_narrow_beams_has_the_nodes_that_a_preview_alone_has(
    quick: TrainConfig, tmp_path: Path
) -> None:
    """Beams of 8 deg: between eleven directions their colors were off by 4.4 % (median)."""
    scene = random_scene(3)
    config = replace(quick, samples=32, preview_nodes=None)
    made = train(scene, tmp_path, config=config)
    assert made.fit.kind == NONE
    rng = np.random.default_rng(1)
    phi = rng.uniform(0.0, np.pi, (20, scene.lamp_count))
    power = rng.dirichlet(np.ones(3), phi.shape)
    found, drawn = (
        checker.run(phi, power, np.array(scene.state_axis))["counts"]
        for checker in (Checker.for_scene(tmp_path, scene), preview_checker(scene, coarse=True))
    )
    off = np.linalg.norm(found - drawn, axis=-1) / np.linalg.norm(drawn, axis=-1)
    assert np.quantile(off, 0.95) < 0.001


def test_the_scale_is_the_previews_whatever_was_rendered(trained: Trained, scene: Scene) -> None:
    scale = scene_scale(scene)
    assert (trained.metadata.exposure, trained.metadata.lam) == (scale.exposure, scale.lam)
    # The invented renders are brighter than the preview, by about exp(0.4 + 0.3).
    assert trained.baseline_counts == pytest.approx(230 * np.exp(0.7), rel=0.3)


BRIEF, LONG = 1e-5, 600.0
"""Minutes in which light cannot be followed, and in which it can."""


@pytest.fixture
def made_preview(
    make_scene: Callable[..., Scene],
    quick: TrainConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> tuple[Scene, Callable[[float | None], TrainingPreview]]:
    """Give a flat sensor, and what makes its training's preview in so many minutes, None in all."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "EFFORT", Effort(photons=2000, paths=128, arrivals=20_000))
    monkeypatch.setattr(training_preview, "NOISE_GOAL", 1.0)
    scene = make_scene(bending={"angles": {"value": [0.0], "unit": "deg", "source": "flat"}})
    scale = scene_scale(scene)

    def made(minutes: float | None) -> TrainingPreview:
        config = replace(quick, coarse=False, preview_nodes=(5, 1), minutes=minutes or 0.0)
        timed = None
        if minutes is not None:
            timed = _fit_time(scene, tmp_path / "run", 0, config, time.monotonic())
        return _preview(scene, tmp_path / "run" / "fit", config, scale, timed, None)

    return scene, made


@pytest.mark.parametrize("more", [LONG, None], ids=["minutes", "samples"])
def test_with_more_time_a_preview_is_converged_that_was_not(
    made_preview: tuple[Scene, Callable[[float | None], TrainingPreview]], more: float | None
) -> None:
    _, made = made_preview
    brief = made(BRIEF)
    assert not brief.converged
    found = made(more)
    assert found.converged
    assert not np.array_equal(found.grid.log_transport, brief.grid.log_transport)
    # Once it is, it stays.
    np.testing.assert_array_equal(made(BRIEF).grid.log_transport, found.grid.log_transport)


def test_a_preview_is_converged_once_light_was_followed_elsewhere(
    made_preview: tuple[Scene, Callable[[float | None], TrainingPreview]],
) -> None:
    scene, made = made_preview
    assert not made(BRIEF).converged
    converged_transport(scene)
    assert made(BRIEF).converged


def test_a_training_that_goes_on_in_the_same_minutes_tries_nothing_again(
    made_preview: tuple[Scene, Callable[[float | None], TrainingPreview]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, made = made_preview
    first = made(BRIEF)
    monkeypatch.delattr("surrogate.train.followed_grid")
    again = made(BRIEF)
    assert again == replace(first, grid=again.grid)
    np.testing.assert_array_equal(again.grid.log_transport, first.grid.log_transport)
