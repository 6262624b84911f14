"""Held-out designs, the nodes that render all of them, and errors against a noisy reference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optimize.design import Design, ScoreSettings
from optimize.frontier.held_out import HeldOutDesigns, HeldOutReference
from optimize.scoring import student_factor
from optimize.verification import DesignRenders
from render.geometry import in_state, is_mirror_symmetric
from render.metric import design_score, site_metric
from render.scene import Scene, load_scene, unchecked
from surrogate.runtime import Checker
from tests.oracles.soft_domes import scene_text_of, write_files, written

MODEL = Path(__file__).resolve().parents[3] / "models" / "finger20"
DESIGNS, LAM = 40, 30.0


def variant(scene: Scene, **counts: int) -> Scene:
    return unchecked(scene, {"fibers": unchecked(scene.fibers, counts)})


def test_the_same_seed_gives_the_same_designs_and_another_one_others(finger20: Scene) -> None:
    first, again, other = (HeldOutDesigns.of(finger20, 5, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.phi, again.phi)
    np.testing.assert_array_equal(first.power, again.power)
    assert (first.phi != other.phi).all()


def test_every_fiber_of_a_design_has_one_color(finger20: Scene) -> None:
    designs = HeldOutDesigns.of(finger20, 30, 0)
    assert len(designs) == 30
    assert ((designs.phi >= 0) & (designs.phi <= np.pi)).all()
    assert (designs.power.sum(axis=-1) == 1).all()
    assert set(np.unique(designs.power)) == {0.0, 1.0}


@pytest.mark.parametrize("tip", [0, 3, 4])
def test_shared_nodes_hold_every_design_and_its_mirror_image(finger20: Scene, tip: int) -> None:
    scene = variant(finger20, tip=tip)
    designs = HeldOutDesigns.of(scene, 7, 0)
    nodes, index = designs.nodes
    assert nodes.shape == (scene.lamp_count, 14)
    assert is_mirror_symmetric(scene, nodes)
    np.testing.assert_array_equal(nodes[np.arange(len(nodes)), index], designs.phi)


def test_a_sensor_without_mirror_images_gets_its_designs_alone(finger20: Scene) -> None:
    scene = variant(finger20, left=7)
    designs = HeldOutDesigns.of(scene, 4, 0)
    nodes, index = designs.nodes
    assert nodes.shape == (scene.lamp_count, 4)
    np.testing.assert_array_equal(nodes[np.arange(len(nodes)), index], designs.phi)


def test_lamps_that_cannot_turn_are_rendered_once_for_all_designs() -> None:
    scene = load_scene("digit")
    designs = HeldOutDesigns.of(scene, 5, 0)
    assert (designs.phi == np.pi / 2).all()
    assert len(np.unique(designs.colors, axis=0)) > 1
    nodes, index = designs.nodes
    assert nodes.shape == (scene.lamp_count, 1)
    assert index.shape == designs.phi.shape
    assert (index == 0).all()


@pytest.fixture
def truth() -> np.ndarray:
    """Return counts ``(design, bend, site, facet, 3)`` whose scores differ well."""
    rng = np.random.default_rng(0)
    bright = rng.uniform(0.3, 1.0, (DESIGNS, 1, 1, 1, 1))
    return rng.uniform(30, 200, (DESIGNS, 2, 4, 6, 3)) * bright


def noisy_reference(counts: np.ndarray, noise: float, seed: int = 1) -> HeldOutReference:
    rng = np.random.default_rng(seed)
    error = noise * counts
    noisy = counts + error * rng.standard_normal(counts.shape)
    scores = np.asarray(design_score(site_metric(counts, LAM)).score)
    designs = HeldOutDesigns.of(load_scene("finger20"), DESIGNS, 0)
    settings = ScoreSettings(1.0, LAM)
    return HeldOutReference(
        designs,
        settings,
        noisy,
        error,
        scores,
        np.full(DESIGNS, 0.5),
        np.full(DESIGNS, 0.5),
        8,
        60.0,
    )


def test_a_perfect_level_has_no_errors_against_an_exact_reference(truth: np.ndarray) -> None:
    row = noisy_reference(truth, 0.0).row("perfect", truth, seconds=0.5, setup=2.0)
    assert row.facet_median == row.facet_p95 == row.facet_rms_true == 0.0
    assert row.score_median == 0.0
    assert row.kendall_tau == 1.0
    assert (row.seconds_per_design, row.setup_seconds) == (0.5, 2.0)


def test_noise_of_the_reference_is_taken_out_of_the_true_error(truth: np.ndarray) -> None:
    noisy = noisy_reference(truth, 0.05)
    perfect = noisy.row("perfect", truth, seconds=1.0)
    assert perfect.facet_median > 0.02
    assert perfect.facet_rms_true < 0.015
    off = noisy.row("3 % too bright", 1.03 * truth, seconds=1.0)
    assert off.facet_rms_true == pytest.approx(0.03, abs=0.008)
    assert perfect.facet_median_true < 0.015
    assert off.facet_median_true == pytest.approx(0.03, abs=0.015)


def test_the_noise_row_is_what_a_perfect_level_shows(truth: np.ndarray) -> None:
    noisy = noisy_reference(truth, 0.05)
    perfect, floor = noisy.row("perfect", truth, seconds=1.0), noisy.noise_row(0)
    assert floor.facet_median == pytest.approx(perfect.facet_median, rel=0.05)


@pytest.mark.parametrize("noise", [0.1, 1.0, 10.0])
def test_intervals_of_short_renders_hold_a_longer_one_as_often_as_they_state(
    truth: np.ndarray, noise: float
) -> None:
    exact = noisy_reference(np.tile(truth, (10, 1, 1, 1, 1)), 0.0)
    rng, count = np.random.default_rng(4), len(exact.scores)
    errors = noise * np.ones(count)
    short = replace(
        exact,
        scores=exact.scores + errors * rng.standard_normal(count),
        scores_se=errors,
        replicates=10_000,
    )
    long = replace(
        exact,
        scores=exact.scores + 0.5 * rng.standard_normal(count),
        scores_se=np.full(count, 0.5),
        replicates=10_000,
    )
    held = long.coverage_of(short)
    assert held.score == pytest.approx(0.9, abs=0.04)
    assert held.half_width == pytest.approx(1.645 * noise, rel=1e-3)
    confident = replace(short, scores_se=0.1 * errors)
    assert noise < 1.0 or long.coverage_of(confident).score < 0.7


def test_noise_of_scores_alone_lowers_tau(truth: np.ndarray) -> None:
    exact = noisy_reference(truth, 0.0)
    assert replace(exact, scores_noise=np.zeros(DESIGNS)).noise_tau == 1.0
    spread = exact.scores.std()
    close, far = (
        replace(exact, scores_noise=np.full(DESIGNS, part * spread)) for part in (0.1, 1.0)
    )
    assert 1.0 > close.noise_tau > far.noise_tau > 0.2


def test_a_level_that_ranks_backwards_has_a_tau_of_minus_one(truth: np.ndarray) -> None:
    exact = noisy_reference(truth, 0.0)
    row = exact.row("backwards", truth, seconds=1.0, scores=-exact.scores)
    assert row.kendall_tau == -1.0
    assert row.kendall_tau_interval == (-1.0, -1.0)


def test_the_interval_of_tau_holds_it_and_narrows_with_better_ranks(truth: np.ndarray) -> None:
    exact = noisy_reference(truth, 0.0)
    rng = np.random.default_rng(2)
    widths = []
    for spread in (0.05, 1.0):
        scores = exact.scores + spread * exact.scores.std() * rng.standard_normal(DESIGNS)
        row = exact.row("noisy ranks", truth, seconds=1.0, scores=scores)
        low, high = row.kendall_tau_interval
        assert low <= row.kendall_tau <= high
        widths.append(high - low)
    assert widths[0] < widths[1]


@pytest.mark.parametrize("noise", [0.0, 1.0, 10.0])
def test_intervals_hold_what_they_promise_whatever_the_noise_of_the_reference(
    finger20: Scene, noise: float
) -> None:
    # A world in which the model's errors are normal and its factors are right.
    checker = Checker.load(MODEL, finger20.hash)
    designs = HeldOutDesigns.of(finger20, 60, 0)
    found = checker.run(designs.phi, designs.power, np.array(finger20.bending.angles))
    rng = np.random.default_rng(0)
    truth = found["counts"] + checker.counts_factor / 1.645 * found[
        "counts_spread"
    ] * rng.standard_normal(found["counts"].shape)
    scores = found["score"] + checker.score_half_width / 1.645 * rng.standard_normal(60)
    reference = HeldOutReference(
        designs=designs,
        settings=ScoreSettings(checker.exposure, checker.lam),
        counts=truth + noise * rng.standard_normal(truth.shape),
        counts_se=np.full(truth.shape, noise),
        scores=scores + noise * rng.standard_normal(60),
        scores_se=np.full(60, noise),
        scores_noise=np.full(60, noise),
        replicates=10_000,
        seconds=1.0,
    )
    held = reference.coverage(checker)
    assert checker.coverage == 0.9
    assert held.counts == pytest.approx(0.9, abs=0.02)
    assert held.half_width == checker.score_half_width
    assert held.score == pytest.approx(0.9, abs=0.1)
    far = replace(reference, counts=reference.counts + 100.0 + 10 * noise)
    assert far.coverage(checker).counts < 0.1


def test_error_bars_of_scores_hold_the_truth_where_neighbors_have_nearly_one_hue(
    finger20: Scene,
) -> None:
    # Twelve sites whose facets differ by 3 % per lamp, rendered with an error of 4 %.
    designs, rng = HeldOutDesigns.of(finger20, 1, 3), np.random.default_rng(4)
    settings, lamps, count = ScoreSettings(200.0, 300.0), finger20.lamp_count, 8
    truth = 0.1 * (1.0 + 0.03 * rng.standard_normal((lamps, 1, 12, 8)))
    scored = settings.parts(truth, designs.power[0])[0]
    off, se, corrected = [], [], []
    for _ in range(60):
        noise = 0.04 * np.sqrt(count) * rng.standard_normal((count, 1, *truth.shape))
        replicates = truth * (1.0 + noise)
        design = Design(designs.phi[0], np.eye(3)[designs.colors[0]])
        renders = DesignRenders((design,), replicates, replicates[..., 0], truth[None], 1.0)
        found = HeldOutReference.of(designs, renders, settings)
        off.append(found.scores[0] - scored)
        se.append(found.scores_se[0])
        corrected.append(renders.score(settings, 0).score.value - scored)
    held = np.abs(off) <= student_factor(count, 0.9) * np.array(se)
    print(
        held.mean(), np.mean(off), np.std(off), np.mean(corrected), np.std(corrected), np.mean(se)
    )
    assert held.mean() > 0.8


@pytest.mark.slow
def test_every_state_has_the_light_of_the_plain_sensor_of_that_skin(tmp_path: Path) -> None:
    write_files(tmp_path, steps=16)
    scene = written(
        tmp_path, scene_text_of("low", "twisted").replace("turns = false", "turns = true")
    )
    designs = HeldOutDesigns.of(scene, 2, 0)

    def render(designs: HeldOutDesigns, folder: str) -> DesignRenders:
        return designs.render("designs", 2, 7, tmp_path / folder, lambda _: None)

    every = render(designs, "states")
    reference = HeldOutReference.of(designs, every, ScoreSettings(1e5, LAM))
    assert reference.counts.shape == (2, 3, 9, 6, 3)
    for number, state in enumerate(scene.state_axis):
        plain, bend = in_state(scene, state)
        alone = render(replace(designs, scene=plain), plain.name)
        assert bend == 0.0
        np.testing.assert_array_equal(every.replicates[:, :, :, [number]], alone.replicates)
        np.testing.assert_array_equal(every.background[:, :, :, [number]], alone.background)
