"""Several designs rendered together, and what such renders say of them: paired comparisons.

One run serves the directions of all designs: every design is one direction node of it, so all of
them are lit by the same light paths. Noise of the paths and of the image's overall scale is then
common to the designs and cancels in their differences, and ten designs cost little more than one.

Whoever wins a noisy contest was lucky as well as good. So finalists are rendered once more with
seeds that had no part in choosing them, and the scores that are reported come from these renders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from optimize.design import Array, Design, ScoreSettings
from optimize.scoring import (
    JackknifeEstimate,
    RenderedScore,
    check_visible,
    paired_difference,
    rendered_score,
)
from render.progress import OnProgress, in_stage
from render.reference import JobRunner, render_transport
from render.scene import Scene


@dataclass(frozen=True, eq=False)
class DesignRenders:
    """What one run says about some designs, with independent replicates on the first axis.

    Arguments:
        designs: in the order of the axis ``design``.
        replicates: transport ``(replicate, design, fiber, bend, site, facet)``.
        background: of the untouched pad, ``(replicate, design, fiber, bend, site)``.
        seconds: spent on rendering, all attempts together.
    """

    designs: tuple[Design, ...]
    replicates: Array
    background: Array
    seconds: float

    def score(self, settings: ScoreSettings, index: int) -> RenderedScore:
        """Return the score of the design ``index`` with its error bars."""
        return rendered_score(settings, self.replicates[:, index], self.designs[index].power)

    def counts(self, settings: ScoreSettings, index: int) -> tuple[Array, Array]:
        """Return facet colors ``(bend, site, facet, 3)`` in counts, and their standard error.

        The error is the one before clipping: a clipped channel would seem to be known exactly.
        """
        replicates, power = self.replicates[:, index], self.designs[index].power
        light = settings.exposure * np.einsum("rfbsk,fc->rbskc", replicates, power)
        counts = settings.counts(replicates.mean(axis=0), power)
        return counts, light.std(axis=0, ddof=1) / np.sqrt(len(light))

    def difference(self, settings: ScoreSettings, first: int, second: int) -> JackknifeEstimate:
        """Return S of the second design minus S of the first, paired."""
        low, high = self.designs[first], self.designs[second]
        return paired_difference(
            settings, self.replicates[:, first], low.power, self.replicates[:, second], high.power
        )


class RenderDesigns(Protocol):
    """Renders designs together, at the scene's bends."""

    def __call__(
        self, designs: Sequence[Design], *, samples: int, seeds: Sequence[int], title: str
    ) -> DesignRenders:
        """Return the renders; ``samples`` per (fiber, facet) pair and seed."""


def reference_renders(
    scene: Scene,
    checkpoint: Path | None,
    progress: OnProgress | None = None,
    runner: JobRunner | None = None,
    per_pass: int | None = None,
) -> RenderDesigns:
    """Return what renders designs of ``scene`` at level 2.

    It goes on from ``checkpoint``; a ``runner`` runs the jobs elsewhere and keeps its own.
    ``per_pass`` is that of ``render_transport``.
    """
    bends = np.array(scene.bending.angles)

    def render(
        designs: Sequence[Design], *, samples: int, seeds: Sequence[int], title: str
    ) -> DesignRenders:
        phi, node = distinct_directions(designs)
        estimate = render_transport(
            scene,
            phi,
            bends,
            samples=samples,
            seeds=seeds,
            per_pass=per_pass,
            checkpoint=checkpoint,
            runner=runner,
            progress=in_stage(progress, title),
        )
        check_visible(estimate.replicates)
        # (replicate, fiber, node, ...) -> (replicate, design, fiber, ...)
        return DesignRenders(
            tuple(designs),
            estimate.replicates[:, :, node].swapaxes(1, 2),
            estimate.background_replicates[:, :, node].swapaxes(1, 2),
            estimate.seconds,
        )

    return render


def distinct_directions(designs: Sequence[Design]) -> tuple[Array, np.ndarray]:
    """Return ``(fiber, node)`` rad without repeats, and the node of every design.

    Designs that differ in their colors alone share a node: light is linear.
    """
    kept: list[Array] = []
    node = []
    for design in designs:
        known = [i for i, phi in enumerate(kept) if np.array_equal(phi, design.phi)]
        if not known:
            known = [len(kept)]
            kept.append(design.phi)
        node.append(known[0])
    return np.stack(kept, axis=1), np.array(node)


FINALISTS = "the finalists"
"""Title of their renders."""
PLURAL = ("colors",)
"""Names of finalists that stand for several things."""


@dataclass(frozen=True, eq=False)
class FinalistEvaluation:
    """Fresh scores of the finalists and their paired differences.

    Arguments:
        names: of the finalists, in the order of everything else.
        renders: what the scores come from.
        settings: of the scores.
    """

    names: tuple[str, ...]
    renders: DesignRenders
    settings: ScoreSettings

    @cached_property
    def scores(self) -> tuple[RenderedScore, ...]:
        """Scores of the finalists."""
        return tuple(self.renders.score(self.settings, i) for i in range(len(self.names)))

    def score(self, name: str) -> RenderedScore:
        """Return the finalist's score."""
        return self.scores[self.names.index(name)]

    def difference(self, first: str, second: str) -> JackknifeEstimate:
        """Return S of the second finalist minus S of the first, paired."""
        i, j = self.names.index(first), self.names.index(second)
        return self.renders.difference(self.settings, i, j)

    def comparison(self, first: str, second: str) -> str:
        """Say which of two finalists is better, or that the renders cannot tell."""
        low, high = self.difference(first, second).interval()
        interval = f"95% interval of the difference {low:.2f} to {high:.2f}"
        if low > 0 or high < 0:
            better, worse = (second, first) if low > 0 else (first, second)
            verb = "are" if better in PLURAL else "is"
            return f"The {better} {verb} better than the {worse} ({interval})."
        return f"The {second} and the {first} tie ({interval})."


def evaluate_finalists(
    render: RenderDesigns,
    settings: ScoreSettings,
    finalists: Sequence[tuple[str, Design]],
    *,
    samples: int,
    seeds: Sequence[int],
) -> FinalistEvaluation:
    """Render the ``finalists`` together and score them; ``seeds`` must be fresh ones."""
    renders = render(
        [design for _, design in finalists],
        samples=samples,
        seeds=seeds,
        title=FINALISTS,
    )
    return FinalistEvaluation(tuple(name for name, _ in finalists), renders, settings)
