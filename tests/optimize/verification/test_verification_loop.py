"""The loop: renders decide, the refit learns, and the loop stops for a reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from optimize.design import baseline_design
from optimize.scoring import TableScorer
from optimize.verification.verification_loop import LoopConfig, VerificationLoop
from render.geometry import fiber_edges
from render.scene import Scene
from render.transport import TransportTable
from surrogate.model.preview_grid import PreviewGrid
from surrogate.training.refit import NewRenders, Refitter
from tests.optimize.verification.pretended_renders import BASE, REPLICATES, biased, pretended


def test_the_refit_learns_a_trend_and_leaves_agreement_alone(
    small: Scene, grid: PreviewGrid, table: TransportTable
) -> None:
    refitter, rng = Refitter(small, grid), np.random.default_rng(2)
    phi = rng.uniform(0.2, 2.9, (6, 8))
    predicted = np.stack([table.at(row) for row in phi])
    predicted = np.concatenate([predicted, predicted.mean(axis=-1, keepdims=True)], axis=-1)
    scatter = 1.0 + 0.1 * rng.standard_normal((REPLICATES, *predicted.shape))
    trend = biased(phi, 0.2)[:, :, None, None, None]

    agreeing = refitter.fit([NewRenders(phi, table.bends, predicted * scatter, predicted)])
    assert agreeing.tau == 0.0
    assert refitter.apply(agreeing, table) is table

    apart = refitter.fit([NewRenders(phi, table.bends, predicted * trend * scatter, predicted)])
    after = refitter.apply(apart, table)
    inner = slice(3, -3)
    error = (after.T / table.T / biased(table.phi, 0.2)[:, None, None, None] - 1.0)[:, inner]
    assert apart.tau > 0.0
    # Designs of one run count as one render, so a strong prior keeps part of the trend.
    assert np.abs(error).mean() < 0.5 * np.abs(biased(table.phi, 0.2) - 1.0)[inner].mean()
    assert (after.se / after.T < table.se / table.T + 1e-15).all()


def test_the_loop_finds_what_the_surrogate_alone_does_not(
    small: Scene, grid: PreviewGrid, table: TransportTable
) -> None:
    baseline, edges = baseline_design(small), fiber_edges(small)
    refitter, amount = Refitter(small, grid), LoopConfig(samples=5, rounds=3)
    loop = VerificationLoop(table, baseline, pretended(table, 0.01), refitter, edges, amount)
    found = loop.run()
    truth = replace(table, T=table.T * biased(table.phi, BASE)[:, None, None, None])
    scorer, alone = TableScorer(truth), found.rounds[0].proposals[1]
    assert alone.role == "best"
    best = found.candidates[0].design
    assert scorer.score(best.phi, best.power) > scorer.score(alone.design.phi, alone.design.power)
    assert scorer.score(best.phi, best.power) > scorer.score(baseline.phi, baseline.power)
    assert found.seconds == 5.0 * len(found.rounds)
    assert all(entry.proposals[0].role == "baseline" for entry in found.rounds)
    gain, se = found.candidates[0].gain
    assert se > 0
    exact = scorer.score(best.phi, best.power) - scorer.score(baseline.phi, baseline.power)
    assert gain == pytest.approx(exact, abs=4 * se)


def test_a_right_surrogate_needs_no_second_round(
    small: Scene, grid: PreviewGrid, table: TransportTable
) -> None:
    refitter, amount = Refitter(small, grid), LoopConfig(samples=5, rounds=4)
    baseline, render = baseline_design(small), pretended(table, 0.003, strength=0.0)
    found = VerificationLoop(table, baseline, render, refitter, fiber_edges(small), amount).run()
    assert len(found.rounds) == 1
    assert found.rounds[0].agreement.tau == 1.0
    assert "nothing better" in found.reason
