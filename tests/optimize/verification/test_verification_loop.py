"""The loop: renders decide, the refit learns, and the loop stops for a reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Design, ScoreSettings, baseline_design
from optimize.objectives import READERS, ObjectiveName, ReaderName
from optimize.readers import CameraModel, expected_error
from optimize.scoring import TableScorer
from optimize.verification.design_renders import RenderDesigns
from optimize.verification.finalists import evaluate_finalists
from optimize.verification.judges import Judge, judge_of
from optimize.verification.verification_loop import LoopConfig, VerificationLoop
from render.chebyshev import interpolation_weights
from render.metric import superposed
from render.scene import Scene
from render.transport import TransportTable
from surrogate.model.preview_grid import PreviewGrid
from surrogate.training.refit import NewRenders, Refitter, ResidualCorrection
from tests.optimize.verification.pretended_renders import (
    BASE,
    REPLICATES,
    ROUND_NOISE,
    biased,
    pretended,
)


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


def test_noise_that_cells_share_is_no_trend(
    small: Scene, grid: PreviewGrid, table: TransportTable
) -> None:
    refitter, rng, supported = Refitter(small, grid), np.random.default_rng(3), []
    power = baseline_design(small).power
    for seed in range(10):
        designs = [Design(phi, power) for phi in rng.uniform(0.2, 2.9, (3, 8))]
        run = observed(table, pretended(table, ROUND_NOISE, strength=0.0), designs, seed)
        supported.append(refitter.fit([run]).tau > 0.0)
    # Borne out at 99 % by chance in one of ten: 10 % of the time.
    assert sum(supported) <= 1
    many = pretended(table, ROUND_NOISE / 8, strength=0.3)
    assert refitter.fit([observed(table, many, designs, 0)]).tau > 0.0


def observed(
    table: TransportTable, render: RenderDesigns, designs: Sequence[Design], seed: int
) -> NewRenders:
    renders = render(designs, samples=1, seeds=[seed], title="")
    phi = np.stack([design.phi for design in designs])
    weights = [interpolation_weights(table.phi, row) for row in phi]
    pads = np.stack([np.einsum("fj,fjbs->fbs", each, table.background) for each in weights])
    predicted = np.stack([table.at(row) for row in phi])
    return NewRenders(
        phi,
        table.bends,
        np.concatenate([renders.replicates, renders.background[..., None]], axis=-1),
        np.concatenate([predicted, pads[..., None]], axis=-1),
    )


def judge(scene: Scene, table: TransportTable, objective: ObjectiveName = "score") -> Judge:
    return judge_of(objective, scene, ScoreSettings(table.exposure, table.lam))


class Misled:
    """A refit that has taken noise for light: it brightens whatever points to the base."""

    def fit(self, runs: Sequence[NewRenders]) -> ResidualCorrection:
        return ResidualCorrection(np.zeros(1), np.zeros((1, 1)), 1.0)

    def apply(self, correction: ResidualCorrection, table: TransportTable) -> TransportTable:
        if correction.tau == 0.0:
            return table
        return replace(table, T=table.T * biased(table.phi, 0.5)[:, None, None, None])


def test_a_refit_that_predicts_worse_is_dropped_and_the_first_optimum_stays(
    small: Scene, table: TransportTable
) -> None:
    baseline, render = baseline_design(small), pretended(table, 0.05, strength=0.0)
    amount = LoopConfig(rounds=2)
    loop = VerificationLoop(judge(small, table), table, baseline, render, Misled(), amount)
    found = loop.run()
    assert len(found.rounds) == 2
    assert loop.misfit > 0.0
    assert loop.table is table
    assert [entry.correction.tau for entry in found.rounds][-1] == 0.0
    assert found.candidates[0].role == "first"


def test_noisy_renders_never_replace_a_first_optimum_that_is_right(
    small: Scene, grid: PreviewGrid, table: TransportTable
) -> None:
    refitter, scorer = Refitter(small, grid), TableScorer(table)
    baseline, render = baseline_design(small), pretended(table, ROUND_NOISE, strength=0.0)
    for seed in range(3):
        amount = LoopConfig(rounds=1, seed=seed)
        loop = VerificationLoop(judge(small, table), table, baseline, render, refitter, amount)
        found = loop.run()
        finalists = [("winner", found.candidates[0].design)]
        finalists += [("runner-up", entry.design) for entry in found.candidates[1:2]]
        verdict = evaluate_finalists(
            pretended(table, ROUND_NOISE / 2, strength=0.0, seconds=10.0),
            loop.judge,
            finalists,
            samples=1,
            seeds=[1000 * seed + 900],
            leader="winner",
            seconds=50.0,
        )
        design = verdict.renders.designs[verdict.names.index(verdict.best("winner"))]
        first = loop.candidates[0].design
        lost = scorer.score(first.phi, first.power) - scorer.score(design.phi, design.power)
        assert lost == pytest.approx(0.0, abs=1e-3 * scorer.score(first.phi, first.power))


def test_the_loop_finds_what_the_surrogate_alone_does_not(
    small: Scene, grid: PreviewGrid, table: TransportTable
) -> None:
    baseline, render = baseline_design(small), pretended(table, 0.01)
    refitter, amount = Refitter(small, grid), LoopConfig(samples=5, rounds=3)
    loop = VerificationLoop(judge(small, table), table, baseline, render, refitter, amount)
    found = loop.run()
    truth = replace(table, T=table.T * biased(table.phi, BASE)[:, None, None, None])
    scorer, alone = TableScorer(truth), found.rounds[0].proposals[1]
    assert alone.role == "first"
    best = found.candidates[0].design
    assert scorer.score(best.phi, best.power) > scorer.score(alone.design.phi, alone.design.power)
    assert scorer.score(best.phi, best.power) > scorer.score(baseline.phi, baseline.power)
    assert found.seconds == 5.0 * len(found.rounds)
    for entry in found.rounds:
        assert [proposal.role for proposal in entry.proposals[:2]] == ["baseline", "first"]
    gain = found.candidates[0].gain
    assert gain.se > 0
    exact = scorer.score(best.phi, best.power) - scorer.score(alone.design.phi, alone.design.power)
    assert gain.value == pytest.approx(exact, abs=4 * gain.se)


def test_a_right_surrogate_needs_no_second_round(
    small: Scene, grid: PreviewGrid, table: TransportTable
) -> None:
    refitter, amount = Refitter(small, grid), LoopConfig(samples=5, rounds=4)
    baseline, render = baseline_design(small), pretended(table, 0.003, strength=0.0)
    loop = VerificationLoop(judge(small, table), table, baseline, render, refitter, amount)
    found = loop.run()
    assert len(found.rounds) == 1
    assert found.rounds[0].agreement.tau == 1.0
    assert "nothing better" in found.reason


@pytest.mark.parametrize("reader", READERS)
def test_a_loop_for_a_reader_finds_what_it_reads_best(
    small: Scene, grid: PreviewGrid, table: TransportTable, reader: ReaderName
) -> None:
    baseline, render = baseline_design(small), pretended(table, 0.01, strength=0.0)
    refitter, amount = Refitter(small, grid), LoopConfig(samples=5, rounds=2)
    decides = judge(small, table, reader)
    found = VerificationLoop(decides, table, baseline, render, refitter, amount).run()
    expected = expected_error(reader, small, CameraModel())

    def error(design: Design) -> float:
        """Return the degrees of the table itself, without noise."""
        weights = interpolation_weights(table.phi, design.phi)
        pad = np.einsum("fj,fjbs->fbs", weights, table.background)
        light = np.concatenate([table.at(design.phi), pad[..., None]], axis=-1)
        return float(expected.degrees(table.exposure * superposed(light, design.power)[None])[0])

    first = found.rounds[0]
    assert error(found.candidates[0].design) < error(baseline)
    for proposal, value in zip(first.proposals, first.values, strict=True):
        assert -proposal.score == pytest.approx(error(proposal.design), rel=1e-6)
        assert -value.value == pytest.approx(error(proposal.design), abs=4 * value.se + 0.01)
