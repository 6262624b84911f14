"""Several designs rendered together, and what such renders say of them: paired comparisons.

One run serves the directions of all designs: every design is one direction node of it, so all of
them are lit by the same light paths. Noise of the paths and of the image's overall scale is then
common to the designs and cancels in their differences, and ten designs cost little more than one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from optimize.design import Array, Design, ScoreSettings
from optimize.scoring import (
    JackknifeEstimate,
    RenderedScore,
    noise_doubt,
    paired_difference,
    rendered_score,
)
from render.metric import superposed
from render.progress import OnProgress, in_stage
from render.reference import (
    EVERYTHING,
    JobRunner,
    SampleAllocation,
    converged,
    more_samples,
    render_transport,
)
from render.scene import Scene

UNCONVERGED_LIGHT = 0.5
"""Share of a design's light in cells that have not converged, from which its score says nothing."""


@dataclass(frozen=True, eq=False)
class DesignRenders:
    """What one run says about some designs, with independent replicates on the first axis.

    Arguments:
        designs: in the order of the axis ``design``.
        replicates: transport ``(replicate, design, fiber, bend, site, facet)``.
        background: of the untouched pad, ``(replicate, design, fiber, bend, site)``; NaN where it
            was not rendered.
        error: standard errors of transport ``(design, fiber, bend, site, facet)``, which allow for
            light that replicates have not seen.

    All three have one more axis ``channel`` where the skin's albedo depends on it.

        seconds: spent on rendering, all attempts together.
    """

    designs: tuple[Design, ...]
    replicates: Array
    background: Array
    error: Array
    seconds: float

    def doubt(self, settings: ScoreSettings, index: int, samples: int | None = None) -> str:
        """Say why the score of design ``index`` has not converged; "" where it has.

        Its light has not, or noise hides what its facets differ by; what lights nothing is known
        without a render. ``samples`` are those per cell; without them it asks for multiples.
        """
        light, error = self.replicates[:, index].mean(axis=0), self.error[index]
        power = self.designs[index].power
        # (fiber, [channel, ...])
        if light.ndim == 5:
            light, error = (np.moveaxis(part, -1, 1) for part in (light, error))
        else:
            power = power.sum(axis=1)
        lit = power > 0
        if not lit.any():
            return ""
        light, error = light[lit], error[lit]
        lost = ~converged(light, error)
        most = power[lit][:, None, None, None] * (light + np.where(lost, error, 0.0))
        share = most[lost].sum() / most.sum()
        if share <= UNCONVERGED_LIGHT:
            design = self.designs[index]
            return noise_doubt(settings, self.replicates[:, index], design.power, samples)
        return (
            f"few light paths carry {share:.0%} of its light; {more_samples(light, error, samples)}"
        )

    def score(self, settings: ScoreSettings, index: int) -> RenderedScore:
        """Return the score of the design ``index`` with its error bars."""
        return rendered_score(settings, self.replicates[:, index], self.designs[index].power)

    @property
    def with_pad(self) -> Array:
        """`replicates` with the untouched pad behind the facets."""
        return np.concatenate([self.replicates, np.expand_dims(self.background, 5)], axis=5)

    def colors(self, settings: ScoreSettings) -> Array:
        """Return counts ``(replicate, design, bend, site, facet + 1, C)``, the pad last.

        They are not clipped.
        """
        power = np.stack([design.power for design in self.designs])
        return settings.exposure * np.stack([superposed(one, power) for one in self.with_pad])

    def counts(self, settings: ScoreSettings, index: int) -> tuple[Array, Array]:
        """Return facet colors ``(bend, site, facet, 3)`` in counts, and their standard error.

        The error is the one before clipping: a clipped channel would seem to be known exactly.
        """
        replicates, power = self.replicates[:, index], self.designs[index].power
        light = settings.exposure * np.stack([superposed(one, power) for one in replicates])
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
        self,
        designs: Sequence[Design],
        *,
        samples: int,
        seeds: Sequence[int],
        title: str,
        allocation: SampleAllocation = EVERYTHING,
    ) -> DesignRenders:
        """Return the renders; ``samples`` per (fiber, facet) pair and seed on average."""


def reference_renders(
    scene: Scene,
    checkpoint: Path | None,
    progress: OnProgress | None = None,
    runner: JobRunner | None = None,
    per_pass: int | None = None,
) -> RenderDesigns:
    """Return what renders designs of ``scene``.

    It goes on from ``checkpoint``; a ``runner`` runs the jobs elsewhere and keeps its own.
    ``per_pass`` is that of ``render_transport``.
    """
    bends = np.array(scene.state_axis)

    def render(
        designs: Sequence[Design],
        *,
        samples: int,
        seeds: Sequence[int],
        title: str,
        allocation: SampleAllocation = EVERYTHING,
    ) -> DesignRenders:
        phi, node = distinct_directions(designs)
        estimate = render_transport(
            scene,
            phi,
            bends,
            samples=samples,
            seeds=seeds,
            per_pass=per_pass,
            allocation=allocation,
            checkpoint=checkpoint,
            runner=runner,
            progress=in_stage(progress, title),
        )
        # (replicate, fiber, node, ...) -> (replicate, design, fiber, ...)
        return DesignRenders(
            tuple(designs),
            estimate.replicates[:, :, node].swapaxes(1, 2),
            estimate.background_replicates[:, :, node].swapaxes(1, 2),
            estimate.se[:, node].swapaxes(0, 1),
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


MANY_SEEDS = 16
"""From so many seeds on, the mean of each is one replicate."""


def pooled_renders(parts: Sequence[DesignRenders], seeds: int) -> DesignRenders:
    """Return the renders of batches of ``seeds`` seeds as one; replicates lie seed by seed."""
    pressed = [one for part in parts for one in np.split(part.replicates, seeds)]
    untouched = [one for part in parts for one in np.split(part.background, seeds)]
    if len(pressed) >= MANY_SEEDS:
        pressed, untouched = (
            [one.mean(axis=0, keepdims=True) for one in each] for each in (pressed, untouched)
        )
    seconds = sum(part.seconds for part in parts)
    error = np.sqrt(np.square([part.error for part in parts]).sum(axis=0)) / len(parts)
    return DesignRenders(
        parts[0].designs, np.concatenate(pressed), np.concatenate(untouched), error, seconds
    )
