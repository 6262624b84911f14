"""Optimizing at level 2: the verification loop, the thesis procedure, or both side by side."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from optimize.design.design import Design
from optimize.design.limits import dimmed_baseline, limits_of
from optimize.design.rating import ScoreSettings
from optimize.exploration.explore import PHI_NODES
from optimize.verification.renders import RenderDesigns
from optimize.verification.thesis import GENERATIONS, ThesisResult, thesis_procedure
from optimize.verification.verdict import Verdict, pronounce
from optimize.verification.verification_loop import (
    SEED_STRIDE,
    LoopConfig,
    LoopResult,
    Round,
    verification_loop,
)
from render.chebyshev import chebyshev_nodes
from render.geometry.layout import fiber_edges
from render.scene.schema import Scene
from surrogate.runtime.checker import Checker

Method = Literal["loop", "thesis", "both"]
THESIS_SEED, FINAL_SEED = 800, 900
"""Added to the render seeds of a loop's seed."""


@dataclass(frozen=True)
class OptimizeConfig:
    """What is run and how much is rendered.

    Arguments:
        method: ``loop``, ``thesis`` or ``both``.
        samples: per cell and render, the same for both methods.
        final_samples: per cell, seed and finalist.
        final_seeds: independent renders of the finalists.
        rounds: of the loop; generations: of the thesis's CMA-ES; both at most.
        seed: of searches and renders.
    """

    method: Method = "loop"
    samples: int = 96
    final_samples: int = 192
    final_seeds: int = 2
    rounds: int = 4
    generations: int = GENERATIONS
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Optimization:
    """What was found, by whom, and what it cost.

    Arguments:
        loop, thesis: outcomes of the methods that were run.
        wall: seconds by method, without the final renders.
        verdict: fresh scores of ``baseline``, ``thesis``, ``winner`` and ``runner-up``.
        training_seconds: of rendering that the surrogate took once, for all designs of the scene.
    """

    loop: LoopResult | None
    thesis: ThesisResult | None
    wall: dict[str, float]
    verdict: Verdict
    training_seconds: float | None

    @property
    def winner(self) -> str:
        """The finalist that is handed over."""
        return "winner" if self.loop else "thesis"

    @property
    def design(self) -> Design:
        """The design that is handed over."""
        verdict = self.verdict
        return verdict.renders.designs[verdict.names.index(self.winner)]


def optimize(
    scene: Scene,
    checker: Checker | None,
    render: RenderDesigns,
    config: OptimizeConfig,
    *,
    on_round: Callable[[Round], None] | None = None,
    on_candidate: Callable[[int, int, float], None] | None = None,
) -> Optimization:
    """Return the outcome of the methods asked for, verified by renders that both share.

    Arguments:
        scene: the sensor.
        checker: its surrogate; the thesis alone can do without.
        render: renders designs together.
        config: what is run.
        on_round: called after every round of the loop.
        on_candidate: called after every generation of the thesis, see `thesis_procedure`.
    """
    baseline, edges = dimmed_baseline(scene), fiber_edges(scene)
    scale = None if checker is None else ScoreSettings(checker.exposure, checker.lam)
    seeds = SEED_STRIDE * (config.seed + 1)
    loop = thesis = None
    wall: dict[str, float] = {}
    finalists = [("baseline", baseline)]
    if config.method != "loop":
        began = time.monotonic()
        thesis = thesis_procedure(
            baseline,
            render,
            edges=edges,
            scale=scale,
            samples=config.samples,
            seed=config.seed,
            render_seed=seeds + THESIS_SEED,
            generations=config.generations,
            report=on_candidate,
        )
        scale = thesis.scale
        wall["thesis"] = time.monotonic() - began
        finalists.append(("thesis", thesis.design))
    if config.method != "thesis" and checker is not None:
        began = time.monotonic()
        loop = _run_loop(scene, checker, baseline, render, config, on_round)
        wall["loop"] = time.monotonic() - began
        best = loop.contenders[:2]
        names = ("winner", "runner-up")
        finalists += [(name, entry.design) for name, entry in zip(names, best, strict=False)]
    assert scale is not None  # from the surrogate or from the thesis's first render
    verdict = pronounce(
        render,
        scale,
        finalists,
        samples=config.final_samples,
        seeds=[seeds + FINAL_SEED + i for i in range(config.final_seeds)],
    )
    trained = None if checker is None else checker.metadata.renderer.get("seconds")
    return Optimization(
        loop, thesis, wall, verdict, float(trained) if isinstance(trained, float) else None
    )


def _run_loop(
    scene: Scene,
    checker: Checker,
    baseline: Design,
    render: RenderDesigns,
    config: OptimizeConfig,
    report: Callable[[Round], None] | None,
) -> LoopResult:
    from surrogate.model.preview_grid import draw_grid
    from surrogate.training.refit import Refitter

    preview = checker.metadata.preview
    grid = draw_grid(scene, int(preview["phi_nodes"]), int(preview["bend_nodes"]))
    return verification_loop(
        checker.transport_table(chebyshev_nodes(PHI_NODES, 0.0, np.pi)),
        baseline,
        render,
        Refitter(scene, grid),
        limits=limits_of(scene),
        edges=fiber_edges(scene),
        config=LoopConfig(config.samples, config.rounds, config.seed),
        report=report,
    )
