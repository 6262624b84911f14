"""Random designs that nothing was fitted to, their long reference render, and errors against it.

Directions are continuous: no design stands on a node that a surrogate was trained at.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from optimize.design import Array, Colors, Design, ScoreSettings
from optimize.scoring import student_factor
from optimize.verification import DesignRenders
from render.geometry import with_mirror_images
from render.levels import REFERENCE, Effort, Level
from render.metric import design_score, site_metric
from render.progress import OnProgress, in_stage
from render.reference import Sampler, render_transport
from render.scene import Scene
from surrogate.runtime import Checker
from surrogate.runtime.metadata import NOISE
from surrogate.training.conformal import Comparison, Quantiles, coverage
from surrogate.training.evaluation import ColorErrors, kendall_tau, random_colors

RESAMPLES = 1000
"""Of the designs, for the interval of Kendall's tau."""
NOISE_DRAWS = 16
"""Of the reference's noise, for what it leaves of a perfect level."""
NOMINAL = 0.9
"""Coverage that the intervals of all levels state."""


@dataclass(frozen=True, eq=False)
class HeldOutDesigns:
    """Random lighting designs of a sensor: ``phi`` rad and ``colors``, (design, fiber) each."""

    scene: Scene
    phi: Array
    colors: Colors

    @classmethod
    def of(cls, scene: Scene, count: int, seed: int) -> HeldOutDesigns:
        """Return ``count`` designs, one color per fiber at full power.

        phi is uniform in [0, pi], or pi/2 of lamps that cannot turn.
        """
        rng, fibers = np.random.default_rng([seed, 11]), scene.lamp_count
        phi = rng.uniform(0.0, np.pi, (count, fibers))
        phi[:, ~np.array(scene.turning)] = np.pi / 2
        return cls(scene, phi, random_colors(count, fibers, rng, len(scene.palette.names)))

    @property
    def power(self) -> Array:
        """What fibers give to the camera's channels, ``(design, fiber, channel)``."""
        return self.scene.palette.matrix[self.colors]

    def __len__(self) -> int:
        """Return the number of designs."""
        return len(self.phi)

    @property
    def bends(self) -> Array:
        """The scene's bends in rad, or the numbers of its states."""
        return np.array(self.scene.state_axis)

    @property
    def nodes(self) -> tuple[Array, np.ndarray]:
        """Directions ``(fiber, node)`` rad, and the nodes of every design ``(design, fiber)``.

        One render serves all designs, since light paths serve every node. On a sensor with mirrored
        fibers the mirror images of all directions join them: the renderer then averages mirrored
        cells, which halves the variance for little more time. Where no lamp turns there is one.
        """
        if not any(self.scene.turning):
            return self.phi[:1].T, np.zeros(self.phi.shape, dtype=np.int64)
        nodes, index = with_mirror_images(self.scene, self.phi.T)
        return nodes, index.T

    def render(
        self,
        title: str,
        samples: int,
        seed: int,
        checkpoint: Path,
        report: OnProgress,
        sampler: Sampler = "monte-carlo",
        per_pass: int | None = None,
    ) -> DesignRenders:
        """Render all designs at the scene's bends in one go; resumes in ``checkpoint``.

        Raises:
            RenderError: no light.
            SceneError: a site that counts is not seen at one of the bends.
        """
        phi, node = self.nodes
        estimate = render_transport(
            self.scene,
            phi,
            self.bends,
            samples=samples,
            seeds=[seed],
            sampler=sampler,
            per_pass=per_pass,
            checkpoint=checkpoint,
            progress=in_stage(report, title),
        )
        # (replicate, fiber, node, ...) -> (replicate, design, fiber, ...)
        pads = estimate.replicates, estimate.background_replicates
        pressed, untouched = (pad[:, np.arange(len(phi)), node] for pad in pads)
        designs = tuple(
            Design.of_colors(phi, colors, self.scene.palette)
            for phi, colors in zip(self.phi, self.colors, strict=True)
        )
        error = estimate.se[np.arange(len(phi)), node]
        return DesignRenders(designs, pressed, untouched, error, estimate.seconds)


@dataclass(frozen=True)
class Interval:
    """What a level's intervals of `NOMINAL` coverage held of the reference.

    Arguments:
        score: fraction of the scores of held-out designs.
        half_width: of the interval of a score, median over designs, counts.
        counts: fraction of the channels of facets; None where a level states no interval of them.
    """

    score: float
    half_width: float
    counts: float | None = None


@dataclass(frozen=True)
class FrontierRow(ColorErrors):
    """Errors of one predictor on the held-out designs; those of facets hold the reference's noise.

    Arguments:
        facet_median_true: ``sqrt(max(facet_median^2 - n^2, 0))`` with the median n that noise alone
            leaves of a perfect level: exact for normal errors that are alike everywhere.
        name: what predicted the designs; level, effort: of it.
        rung: the name in words that all scenes share.
        seconds_per_design: wall time of one design, all bends.
        setup_seconds: spent once, before the first design.
        kendall_tau_interval: holds tau of 95 % of resampled sets of designs.
        interval: how often its own intervals hold; None where it states none.
        photon_noise: of its colors, relative, as traced light says it.
    """

    facet_median_true: float
    name: str
    rung: str
    level: Level
    effort: Effort | None
    seconds_per_design: float
    setup_seconds: float
    kendall_tau_interval: tuple[float, float]
    interval: Interval | None
    photon_noise: float | None = None


@dataclass(frozen=True, eq=False)
class HeldOutReference:
    """Counts and scores of the held-out designs by the reference, with their error bars.

    Arguments:
        designs: what was rendered; settings: of the scores.
        counts, counts_se: ``(design, bend, site, facet, channel)`` and one standard error.
        scores, scores_se: ``(design,)``, freed of the noise's bias; what that may be off by is a
            part of the error.
        scores_noise: ``(design,)`` standard error by the noise of replicates alone.
        replicates: independent groups of chains behind the error bars.
        seconds: of the render.
    """

    designs: HeldOutDesigns
    settings: ScoreSettings
    counts: Array
    counts_se: Array
    scores: Array
    scores_se: Array
    scores_noise: Array
    replicates: int
    seconds: float

    @classmethod
    def of(
        cls, designs: HeldOutDesigns, renders: DesignRenders, settings: ScoreSettings
    ) -> HeldOutReference:
        """Return counts and scores of ``renders`` with error bars from its replicates."""
        colors = [renders.counts(settings, i) for i in range(len(designs))]
        scores = [renders.score(settings, i).score for i in range(len(designs))]
        return cls(
            designs,
            settings,
            counts=np.stack([counts for counts, _ in colors]),
            counts_se=np.stack([se for _, se in colors]),
            scores=np.array([score.value for score in scores]),
            scores_se=np.array([score.se for score in scores]),
            scores_noise=np.array([score.sampling for score in scores]),
            replicates=len(renders.replicates),
            seconds=renders.seconds,
        )

    @property
    def score_se(self) -> float:
        """Median standard error of the scores."""
        return float(np.median(self.scores_se))

    def row(
        self,
        name: str,
        counts: Array,
        seconds: float,
        *,
        rung: str = "",
        setup: float = 0.0,
        scores: Array | None = None,
        interval: Interval | None = None,
    ) -> FrontierRow:
        """Return the errors of ``counts`` ``(design, bend, site, facet, channel)``.

        ``seconds`` are per design, ``setup`` once. ``scores`` ``(design,)`` are given where the
        predictor has better ones than those of its mean counts; ``rung`` is ``name`` unless told.
        The row is of the reference, unless who asks puts another level into it.
        """
        if scores is None:
            scores = np.asarray(design_score(site_metric(counts, self.settings.lam)).score)
        errors = ColorErrors.of(counts, scores, self.counts, self.counts_se, self.scores)
        # The interval of tau is the percentile interval over resampled designs (Efron 1979).
        picks = np.random.default_rng(0).integers(0, len(scores), (RESAMPLES, len(scores)))
        taus = [kendall_tau(scores[pick], self.scores[pick]) for pick in picks]
        low, high = (float(tau) for tau in np.quantile(taus, [0.025, 0.975]))
        return FrontierRow(
            **vars(errors),
            facet_median_true=float(np.sqrt(max(errors.facet_median**2 - self.noise_median**2, 0))),
            name=name,
            rung=rung or name,
            level=REFERENCE,
            effort=None,
            seconds_per_design=seconds,
            setup_seconds=setup,
            kendall_tau_interval=(low, high),
            interval=interval,
        )

    @cached_property
    def noise_median(self) -> float:
        """Median error of facet colors that noise alone leaves of a perfect level."""
        light = np.linalg.norm(self.counts, axis=-1)
        drawn = self._noisy(np.random.default_rng(13)) - self.counts
        return float(np.median(np.linalg.norm(drawn, axis=-1)[light > 0] / light[light > 0]))

    @cached_property
    def noise_tau(self) -> float:
        """Kendall's tau that noise alone leaves of a perfect level at least: `NOISE_DRAWS` draws.

        Designs share light paths, and noise that they have in common moves no ranks; here each
        design has its own.
        """
        rng = np.random.default_rng(14)
        noise = self.scores_noise * rng.standard_normal((NOISE_DRAWS, len(self.scores)))
        return float(np.mean([kendall_tau(self.scores, self.scores + one) for one in noise]))

    def _noisy(self, rng: np.random.Generator) -> Array:
        noisy = self.counts + self.counts_se * rng.standard_normal(self.counts.shape)
        return np.asarray(noisy.clip(0.0))

    def noise_row(self, seed: int) -> FrontierRow:
        """Return what a perfect level would show: the reference against itself, noise once more."""
        rng = np.random.default_rng([seed, 12])
        noisy = self._noisy(rng)
        scores = self.scores + self.scores_noise * rng.standard_normal(len(self.scores))
        seconds = self.seconds / len(self.scores)
        row = self.row(NOISE, noisy, seconds, scores=scores)
        return replace(row, kendall_tau=self.noise_tau)

    def to_json(self) -> dict[str, object]:
        """Return how well it is known, and the scores."""
        noise = np.linalg.norm(self.counts_se, axis=-1) / np.linalg.norm(self.counts, axis=-1)
        return {
            "level": REFERENCE,
            "name": "reference (bidirectional, MIS)",
            "replicates": self.replicates,
            "seconds": self.seconds,
            "facet_se_median": float(np.median(noise)),
            "facet_se_p95": float(np.quantile(noise, 0.95)),
            "score_se_median": self.score_se,
            "scores": self.scores.tolist(),
            "scores_se": self.scores_se.tolist(),
        }

    def coverage(self, checker: Checker) -> Interval:
        """Return how often the intervals of ``checker`` hold this independent reference.

        They are meant for the reference without its noise. Its own interval of the same coverage,
        by Student's t over its replicates, is added in quadrature: two normal errors would then be
        held exactly as often as stated.
        """
        predicted = checker.run(self.designs.phi, self.designs.power, self.designs.bends)
        factor = student_factor(self.replicates, checker.coverage)
        spread = predicted["counts_spread"].astype(np.float64)
        lit = spread > 0
        compared = Comparison(
            error=(predicted["counts"] - self.counts)[lit],
            spread=spread[lit],
            noise=factor / checker.counts_factor * self.counts_se[lit],
            score_error=predicted["score"] - self.scores,
            score_noise=factor * self.scores_se,
        )
        half_width = checker.score_half_width
        held = coverage(compared, Quantiles(checker.counts_factor, 1.0, half_width))
        return Interval(held.score, half_width, held.counts)

    def coverage_of(self, renders: HeldOutReference) -> Interval:
        """Return how often the intervals of shorter ``renders`` hold this one, as `coverage`."""
        half_width = student_factor(renders.replicates, NOMINAL) * renders.scores_se
        own = student_factor(self.replicates, NOMINAL) * self.scores_se
        held = np.abs(renders.scores - self.scores) <= np.hypot(half_width, own)
        return Interval(float(np.mean(held)), float(np.median(half_width)))
