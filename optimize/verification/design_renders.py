"""Several designs rendered together, and what such renders say of them: paired comparisons.

One run serves the directions of all designs: every design is one direction node of it, so all of
them are lit by the same light paths. Noise of the paths and of the image's overall scale is then
common to the designs and cancels in their differences, and ten designs cost little more than one.

Whoever wins a noisy contest was lucky as well as good. So finalists are rendered once more with
seeds that had no part in choosing them, and the scores that are reported come from these renders.
They go on, batch by batch, until the verdict is significant, cannot become so any more, or their
time is used. Looking again and again finds something by chance, so every look has a share of the
error rate alpha = 5 %: that of the time that it took, alpha t in all after the fraction t (alpha
spending, Lan and DeMets 1983; power family with rho = 1, Kim and DeMets 1987). Shares add up to
alpha at most, so the intervals of the last look hold whenever renders end (union bound).
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
    noise_doubt,
    paired_difference,
    rendered_score,
    student_factor,
)
from render.metric import superposed
from render.progress import OnProgress, in_stage
from render.reference import (
    EVERYTHING,
    PRESSED,
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
    """Return what renders designs of ``scene`` at level 2.

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


FINALISTS = "the finalists"
"""Title of their renders."""
PLURAL = ("colors",)
"""Names of finalists that stand for several things."""
ALPHA = 0.05
"""Rate at which intervals may fail, all looks together."""
MANY_SEEDS = 16
"""From so many seeds on, the mean of each is one replicate."""


@dataclass(frozen=True, eq=False)
class FinalistEvaluation:
    """Fresh scores of the finalists and their paired differences.

    Arguments:
        names: of the finalists, in the order of everything else.
        renders: what the scores come from.
        settings: of the scores.
        confidence: of this look's intervals, which are 95 % intervals for all looks together.
    """

    names: tuple[str, ...]
    renders: DesignRenders
    settings: ScoreSettings
    confidence: float = 0.95

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

    def interval(self, first: str, second: str) -> tuple[float, float]:
        """Return the 95 % interval of that difference."""
        return self.difference(first, second).interval(self.confidence)

    def best(self, leader: str) -> str:
        """Return ``leader``, unless renders show that another is better by more than error bars.

        Those that have not converged show nothing.
        """
        for name in self.names:
            better = name != leader and self.interval(leader, name)[0] > 0
            if better and not (self.doubt(leader) or self.doubt(name)):
                leader = name
        return leader

    def settled(self, leader: str, used: float) -> bool:
        """Return whether more renders are of no use.

        All have converged, and the best is better than every other one by more than the error
        bars, or a tie with it stays one: even if the difference is a standard error larger, the
        interval would hold 0 when all of the time is used, of which ``used`` is the fraction so
        far.
        """
        if any(self.doubt(name) for name in self.names):
            return False
        best, count = self.best(leader), len(self.renders.replicates)
        factor = student_factor(round(count / used)) * np.sqrt(used)
        for name in self.names:
            low, high = self.interval(name, best) if name != best else (1.0, 1.0)
            gain = self.difference(name, best)
            if low <= 0.0 <= high and abs(gain.value) + gain.se > factor * gain.se:
                return False
        return True

    def doubt(self, name: str) -> str:
        """Say why the finalist's score has not converged; "" where it has."""
        return self._doubts[self.names.index(name)]

    @cached_property
    def _doubts(self) -> tuple[str, ...]:
        return tuple(self.renders.doubt(self.settings, i) for i in range(len(self.names)))

    def comparison(self, first: str, second: str) -> str:
        """Say which of two finalists is better, or that the renders cannot tell."""
        for name in (second, first):
            if said := self.doubt(name):
                return f"The renders of the {name} have not converged: {said}."
        low, high = self.interval(first, second)
        interval = f"95% interval of the difference {low:.2f} to {high:.2f}"
        if low > 0 or high < 0:
            better, worse = (second, first) if low > 0 else (first, second)
            verb = "are" if better in PLURAL else "is"
            return f"The {better} {verb} better in S than the {worse} ({interval})."
        return f"The {second} and the {first} tie ({interval})."


def evaluate_finalists(
    render: RenderDesigns,
    settings: ScoreSettings,
    finalists: Sequence[tuple[str, Design]],
    *,
    samples: int,
    seeds: Sequence[int],
    leader: str = "",
    seconds: float = 0.0,
    allocation: SampleAllocation = PRESSED,
) -> FinalistEvaluation:
    """Render the ``finalists`` together until the verdict is settled, and score them.

    Arguments:
        render: renders designs together.
        settings: of the scores.
        finalists: names and designs.
        samples: per cell and seed.
        seeds: of the first batch, fresh ones; those of the next ones follow.
        leader: whose differences matter, unless another turns out to be better.
        seconds: of rendering at most; the first batch is always rendered.
        allocation: where the samples go, in all batches alike.
    """
    names, designs = tuple(name for name, _ in finalists), [design for _, design in finalists]
    parts: list[DesignRenders] = []
    before = 0.0
    while True:
        batch = [seed + len(parts) * len(seeds) for seed in seeds]
        parts.append(
            render(designs, samples=samples, seeds=batch, title=FINALISTS, allocation=allocation)
        )
        renders = pooled_renders(parts, len(seeds))
        last = renders.seconds + max(part.seconds for part in parts) > seconds
        used = 1.0 if last else renders.seconds / seconds
        level = 1.0 - ALPHA * (used - before)
        evaluation = FinalistEvaluation(names, renders, settings, level)
        if last or evaluation.settled(leader, used):
            return evaluation
        before = used


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
