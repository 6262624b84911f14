"""The thesis's own procedure on pretended renders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from optimize.design import ScoreSettings, baseline_design, turning_limits
from optimize.scoring import TableScorer
from optimize.verification import OptimizeConfig, optimize
from optimize.verification.design_renders import (
    DesignRenders,
)
from optimize.verification.thesis import thesis_on_table, thesis_procedure
from render.choose_exposure import scene_scale
from render.geometry import fiber_edges
from render.scene import Scene, load_scene
from render.transport import TransportTable
from tests.optimize.verification.pretended_renders import pretended


def test_the_thesis_procedure_renders_every_candidate(small: Scene, table: TransportTable) -> None:
    calls: list[int] = []

    def counted(*args: object, **kwargs: object) -> DesignRenders:
        calls.append(1)
        render: Callable[..., DesignRenders] = pretended(table, 0.01)
        return render(*args, **kwargs)

    baseline, edges = baseline_design(small), fiber_edges(small)
    settings = ScoreSettings(table.exposure, table.lam)
    found = thesis_procedure(
        baseline, counted, edges=edges, limits=turning_limits(small), settings=settings, samples=7,
        seed=1, render_seed=3, generations=3,
    )  # fmt: skip
    assert found.runs == len(calls) == found.directions.evaluated + 1
    assert found.seconds == 7.0 * len(calls)
    assert found.score > settings.parts(table.at(baseline.phi), baseline.power)[0]
    keys = list(zip(edges, found.design.colors.tolist(), strict=True))
    for key in set(keys):  # fibers of one side and color share a direction
        own = [phi for phi, other in zip(found.design.phi, keys, strict=True) if other == key]
        assert len(set(own)) == 1


def test_without_a_surrogate_the_scale_is_the_previews_however_noisy_the_renders(
    small: Scene, table: TransportTable
) -> None:
    config = OptimizeConfig(method="thesis", generations=1, final_seeds=1)
    found = optimize(small, None, pretended(table, 0.5), config)
    assert found.finalists.settings == ScoreSettings(**asdict(scene_scale(small)))


def test_the_thesis_procedure_leaves_lamps_alone_that_cannot_turn() -> None:
    digit = load_scene("digit")
    lamps, sites, faces = digit.lamp_count, digit.sites.count, digit.indenter.faces
    transport = np.random.default_rng(0).uniform(0.5, 1.5, (lamps, 1, 1, sites, faces))
    scorer = TableScorer(
        TransportTable(
            T=transport, se=np.zeros_like(transport), phi=np.array([np.pi / 2]), exposure=100.0,
            lam=300.0,
        ),
        limits=turning_limits(digit),
    )  # fmt: skip
    found = thesis_on_table(scorer, baseline_design(digit), fiber_edges(digit), seed=0)
    assert found.phi.tolist() == [np.pi / 2] * lamps
