"""Held-out designs and how they are graded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kendalltau

from render.metric import design_score, image_counts, site_metric
from render.transport import TransportTable
from surrogate.training.evaluation import (
    HeldOutEvaluation,
    kendall_tau,
    random_designs,
    scene_bends,
)

SHAPE = (4, 6, 2, 3, 5)  # direction, fiber, bend, site, normal


@pytest.fixture
def evaluation() -> HeldOutEvaluation:
    rng = np.random.default_rng(0)
    designs = random_designs(40, np.ones(SHAPE[:2], dtype=bool), np.zeros(SHAPE[0]), rng)
    reference = rng.uniform(1.0, 2.0, SHAPE)
    known = np.ones(SHAPE, dtype=bool)
    return HeldOutEvaluation(
        reference=reference,
        error=0.1 * reference,
        reliable=known,
        designs=designs,
        exposure=5.0,
        lam=10.0,
        held_out=known[..., 0, 0],
        bends=np.arange(2),
    )


def test_a_perfect_prediction_has_no_error(evaluation: HeldOutEvaluation) -> None:
    errors = evaluation.errors("reference", evaluation.reference)
    assert (errors.cell_p95, errors.facet_p95, errors.score_p95, errors.kendall_tau) == (0, 0, 0, 1)


def test_known_noise_of_the_reference_is_taken_off_the_error(evaluation: HeldOutEvaluation) -> None:
    rng = np.random.default_rng(1)
    noise = evaluation.error * rng.standard_normal(SHAPE)
    noisy = replace(evaluation, reference=evaluation.reference + noise)
    errors = noisy.errors("the truth", evaluation.reference)
    assert errors.facet_rms > 0.03
    assert errors.facet_rms_true < 0.4 * errors.facet_rms


def test_a_common_factor_is_the_error_of_every_facet(evaluation: HeldOutEvaluation) -> None:
    errors = evaluation.errors("dim", 0.9 * evaluation.reference)
    assert errors.cell_median == pytest.approx(0.1)
    assert errors.facet_p95 == pytest.approx(0.1)
    assert errors.kendall_tau > 0.9


def test_a_design_is_lit_by_its_own_directions_and_colors(evaluation: HeldOutEvaluation) -> None:
    counts = evaluation.counts(evaluation.reference)
    direction, power = evaluation.designs.direction[7], evaluation.designs.power[7]
    light = np.stack([evaluation.reference[direction[f], f, ..., :-1] for f in range(SHAPE[1])])
    expected = image_counts(light, power, evaluation.exposure)
    np.testing.assert_allclose(counts[7], expected)
    score = design_score(site_metric(expected, evaluation.lam)).score
    assert evaluation.scores(counts)[7] == pytest.approx(float(score))


def test_designs_keep_to_the_allowed_directions() -> None:
    allowed = np.zeros((4, 6), dtype=bool)
    allowed[2] = True
    allowed[0, 1] = True
    designs = random_designs(50, allowed, np.zeros(4), np.random.default_rng(0))
    assert set(designs.direction[:, 1]) == {0, 2}
    assert (np.delete(designs.direction, 1, axis=1) == 2).all()


def test_a_design_is_of_one_material() -> None:
    allowed, block = np.ones((4, 6), dtype=bool), np.array([0, 0, 1, 1])
    allowed[2:, 3] = False  # no design of the second material can light fiber 3
    designs = random_designs(30, np.ones((4, 6), dtype=bool), block, np.random.default_rng(0))
    of = block[designs.direction]
    assert (of == of[:, :1]).all()
    assert set(of[:, 0]) == {0, 1}
    some = random_designs(30, allowed, block, np.random.default_rng(0))
    assert set(block[some.direction].ravel()) == {0}


def test_neighboring_fibers_share_colors_in_runs() -> None:
    designs = random_designs(3, np.ones((2, 8), dtype=bool), np.zeros(2), np.random.default_rng(1))
    color = designs.power.argmax(axis=-1)
    assert (color[1, 0::2] == color[1, 1::2]).all()
    assert (color[2, :4] == color[2, 0]).all()
    assert (designs.power.sum(axis=-1) == 1).all()


def test_kendall_tau_is_that_of_scipy_with_ties() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, 9, 40).astype(float), rng.normal(size=40)
    assert kendall_tau(a, b) == pytest.approx(kendalltau(a, b).statistic)
    assert kendall_tau(np.ones(5), np.arange(5.0)) == 0.0


def test_scores_are_over_the_scenes_bends_where_the_table_has_them() -> None:
    bends = np.array([0.0, 0.2, 0.7])
    ones = np.ones((1, 1, 3, 1, 1))
    table = TransportTable(ones, 0 * ones, np.zeros(1), 1.0, 1.0, bends=bends)
    assert scene_bends(table, (0.0, 0.7)).tolist() == [0, 2]
    assert scene_bends(table, (0.0, 0.5)).tolist() == [0, 1, 2]
