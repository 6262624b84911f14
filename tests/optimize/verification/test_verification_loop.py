"""The loop: renders decide, the refit learns, and the loop stops for a reason."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Design, ScoreSettings, baseline_design
from optimize.scoring import TableScorer, rank_agreement
from optimize.search.colors import canonical
from optimize.verification.design_proposals import propose, random_design, same_design
from optimize.verification.design_renders import (
    DesignRenders,
    RenderDesigns,
    distinct_directions,
    evaluate_finalists,
)
from optimize.verification.thesis import baseline_settings, thesis_procedure
from optimize.verification.verification_loop import LoopConfig, verification_loop
from render.chebyshev import chebyshev_nodes, interpolation_weights
from render.geometry import fiber_edges
from render.preview import Preview
from render.scene import Scene, load_scene
from render.transport import TransportTable
from surrogate.model.preview_grid import PreviewGrid, draw_grid
from surrogate.training.refit import NewRenders, Refitter

REPLICATES = 8
BASE = 0.5
"""A bias of the pretended renders against the surrogate: darker where fibers turn to the base."""


@pytest.fixture(scope="module")
def small() -> Scene:
    scene = load_scene("finger20")
    fibers = scene.fibers.model_copy(update={"left": 3, "tip": 2, "right": 3})
    sites = scene.sites.model_copy(update={"columns": 2, "rows": 2})
    indenter = scene.indenter.model_copy(update={"faces": 5})
    bending = scene.bending.model_copy(update={"angles": scene.bending.angles[:2]})
    return scene.model_copy(
        update={"fibers": fibers, "sites": sites, "indenter": indenter, "bending": bending}
    )


@pytest.fixture(scope="module")
def grid(small: Scene) -> PreviewGrid:
    return draw_grid(small, 7, 3)


@pytest.fixture(scope="module")
def table(small: Scene) -> TransportTable:
    """Return the preview, which is the surrogate here."""
    phi, bends = chebyshev_nodes(13, 0.0, np.pi), np.array(small.bending.angles)
    with Preview(small) as preview:
        transport, background = preview.transport(phi, bends)
    plain = TransportTable(
        T=transport,
        se=0.03 * transport,
        phi=phi,
        exposure=1.0,
        lam=1.0,
        level="surrogate",
        bends=bends,
        background=background,
        background_se=0.03 * background,
    )
    base = baseline_design(small)
    settings = baseline_settings(plain.at(base.phi), base.power)
    return replace(plain, exposure=settings.exposure, lam=settings.lam)


def biased(phi: np.ndarray, strength: float) -> np.ndarray:
    return np.exp(strength * np.cos(phi))


def pretended(table: TransportTable, noise: float, strength: float = BASE) -> RenderDesigns:
    """Return what renders from the table times a bias, with noise that designs share in part."""

    def render(
        designs: Sequence[Design], *, samples: int, seeds: Sequence[int], title: str
    ) -> DesignRenders:
        rng = np.random.default_rng(list(seeds))
        shape = (REPLICATES * len(seeds), *table.T.shape[:1], *table.T.shape[2:])
        common = noise * rng.standard_normal(shape)
        facets, pads = [], []
        for design in designs:
            weights = interpolation_weights(table.phi, design.phi)
            factor = biased(design.phi, strength)[:, None, None]
            own = 0.5 * noise * rng.standard_normal(shape)
            truth = table.at(design.phi) * factor[..., None]
            facets.append(truth * (1.0 + common + own))
            pad = np.einsum("fj,fjbs->fbs", weights, table.background) * factor
            pads.append(pad * (1.0 + common[..., 0]))
        return DesignRenders(
            tuple(designs), np.stack(facets, axis=1), np.stack(pads, axis=1), float(samples)
        )

    return render


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
    found = verification_loop(
        table,
        baseline,
        pretended(table, 0.01),
        Refitter(small, grid),
        edges=edges,
        config=LoopConfig(samples=5, rounds=3),
    )
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
    found = verification_loop(
        table,
        baseline_design(small),
        pretended(table, 0.003, strength=0.0),
        Refitter(small, grid),
        edges=fiber_edges(small),
        config=LoopConfig(samples=5, rounds=4),
    )
    assert len(found.rounds) == 1
    assert found.rounds[0].agreement.tau == 1.0
    assert "nothing better" in found.reason


def test_proposals_are_new_and_differ(small: Scene, table: TransportTable) -> None:
    scorer, base = TableScorer(table), baseline_design(small)
    first = propose(scorer, base, edges=fiber_edges(small), seed=4)
    assert [entry.role for entry in first] == ["best", "uncertain", "random"]
    assert all(entry.spread > 0 for entry in first)
    again = propose(
        scorer, base, edges=fiber_edges(small), seed=4, known=[entry.design for entry in first]
    )
    assert not again
    twin = first[0].design.colors[::-1]
    other = first[1].design.colors
    assert canonical(twin[None]).tolist() != canonical(other[None]).tolist()
    assert not same_design(random_design(scorer, 1), random_design(scorer, 2))


def test_designs_of_equal_directions_share_a_node() -> None:
    phi = np.full(4, 1.0)
    designs = [
        Design.of_colors(phi, [0, 1, 2, 0]),
        Design.of_colors(phi + 0.1, [0, 1, 2, 0]),
        Design.of_colors(phi, [2, 1, 0, 0]),
    ]
    nodes, which = distinct_directions(designs)
    assert nodes.shape == (4, 2)
    assert which.tolist() == [0, 1, 0]


def test_undecided_pairs_do_not_count_in_the_ranking() -> None:
    interval = {(0, 1): (1.0, 2.0), (0, 2): (-1.0, 2.0), (1, 2): (-3.0, -1.0)}
    right = rank_agreement(np.array([1.0, 3.0, 2.0]), lambda i, j: interval[i, j])
    assert (right.tau, right.decided, right.pairs) == (1.0, 2, 3)
    wrong = rank_agreement(np.array([3.0, 2.0, 2.5]), lambda i, j: interval[i, j])
    assert wrong.tau == -1.0
    nothing = rank_agreement(np.array([1.0, 2.0]), lambda i, j: (-1.0, 1.0))
    assert nothing.tau is None
    assert "none of 1 pairs" in nothing.shown


def test_the_thesis_procedure_renders_every_candidate(small: Scene, table: TransportTable) -> None:
    calls: list[int] = []

    def counted(*args: object, **kwargs: object) -> DesignRenders:
        calls.append(1)
        render: Callable[..., DesignRenders] = pretended(table, 0.01)
        return render(*args, **kwargs)

    baseline, edges = baseline_design(small), fiber_edges(small)
    found = thesis_procedure(
        baseline, counted, edges=edges, settings=None, samples=7, seed=1, render_seed=3,
        generations=3,
    )  # fmt: skip
    assert found.runs == len(calls) == found.directions.evaluated + 1
    assert found.seconds == 7.0 * len(calls)
    assert found.score > found.settings.parts(table.at(baseline.phi), baseline.power)[0]
    keys = list(zip(edges, found.design.colors.tolist(), strict=True))
    for key in set(keys):  # fibers of one side and color share a direction
        own = [phi for phi, other in zip(found.design.phi, keys, strict=True) if other == key]
        assert len(set(own)) == 1


def test_the_evaluation_of_finalists_tells_a_gain_from_a_tie(
    small: Scene, table: TransportTable
) -> None:
    base, settings = baseline_design(small), ScoreSettings(table.exposure, table.lam)
    dim = Design(base.phi, 0.5 * base.power)
    same = Design(base.phi + 1e-4, base.power)
    found = evaluate_finalists(
        pretended(table, 0.02), settings, [("baseline", base), ("dim", dim), ("same", same)],
        samples=3, seeds=[1, 2],
    )  # fmt: skip
    assert found.comparison("dim", "baseline").startswith("The baseline is better than the dim")
    assert "tie" in found.comparison("baseline", "same")
    plural = replace(found, names=("baseline", "colors", *found.names[2:]))
    said = {plural.comparison("baseline", "colors"), plural.comparison("colors", "baseline")}
    assert all(text.startswith("The baseline is better than the colors") for text in said)
    worse = replace(plural, names=("colors", "baseline", *found.names[2:]))
    assert worse.comparison("colors", "baseline").startswith(
        "The colors are better than the baseline"
    )
    exact = settings.parts(table.at(base.phi) * biased(base.phi, BASE)[:, None, None, None],
                        base.power)[0]  # fmt: skip
    score = found.score("baseline").score
    assert score.value == pytest.approx(exact, abs=4 * score.se)
