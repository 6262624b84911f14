"""The thesis's own procedure on pretended renders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

from optimize.design import ScoreSettings, baseline_design
from optimize.verification import OptimizeConfig, optimize
from optimize.verification.design_renders import (
    DesignRenders,
)
from optimize.verification.thesis import thesis_procedure
from render.geometry import fiber_edges
from render.scale import scene_scale
from render.scene import Scene
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
        baseline, counted, edges=edges, settings=settings, samples=7, seed=1, render_seed=3,
        generations=3,
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
