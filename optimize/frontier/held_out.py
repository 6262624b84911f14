"""Random designs that nothing was fitted to, their long reference render, and errors against it.

Directions are continuous: no design stands on a node that a surrogate was trained at.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from optimize.scoring import check_visible, jackknife, student_factor
from render.arrays import Array
from render.geometry import fiber_edges, mirrored_fibers
from render.metric import clip_counts, design_score, image_counts, site_metric
from render.progress import OnProgress, in_stage
from render.reference import Sampler, TransportEstimate, render_transport
from render.scene import Scene
from surrogate.runtime import Checker
from surrogate.training.conformal import Comparison, Coverage, Quantiles, coverage
from surrogate.training.evaluation import kendall_tau, random_colors

REFERENCE_SEED, SHORT_SEED, TRACER_SEED = 101, 201, 301
"""Seeds of the long render, of the short ones and of the path tracer; training counts from 1."""
RESAMPLES = 1000
"""Of the designs, for the interval of Kendall's tau."""


@dataclass(frozen=True)
class HeldOutDesigns:
    """Random lighting designs of a sensor, and direction nodes that hold all of them.

    Arguments:
        scene: the sensor.
        phi: ``(design, fiber)`` rad, uniform in [0, pi].
        power: ``(design, fiber, 3)``, one color per fiber at full power.
        nodes: ``(fiber, node)`` rad, of one render of all designs.
        node: ``(design, fiber)`` index of the node at which a fiber stands in a design.
    """

    scene: Scene
    phi: Array
    power: Array
    nodes: Array
    node: np.ndarray

    def __len__(self) -> int:
        """Return the number of designs."""
        return len(self.phi)

    def of_nodes(self, transport: Array) -> Array:
        """Return ``(design, fiber, ...)`` of transport per node ``(fiber, node, ...)``."""
        return np.asarray(transport[np.arange(len(self.nodes)), self.node])

    def render(
        self,
        title: str,
        *,
        samples: int,
        seed: int,
        checkpoint: Path,
        report: OnProgress,
        sampler: Sampler = "monte-carlo",
    ) -> TransportEstimate:
        """Render all nodes at the scene's bends in one go; resumes in ``checkpoint``.

        Raises:
            RenderError: no light, or a facet that the camera cannot see.
        """
        estimate = render_transport(
            self.scene,
            self.nodes,
            np.array(self.scene.bending.angles),
            samples=samples,
            seeds=[seed],
            sampler=sampler,
            checkpoint=checkpoint,
            progress=in_stage(report, title),
        )
        check_visible(estimate.replicates)
        return estimate


def held_out_designs(scene: Scene, count: int, seed: int) -> HeldOutDesigns:
    """Return ``count`` random designs of ``scene``; the same for the same seed.

    One render serves them all, since light paths serve every node. On a sensor with mirrored
    fibers the mirror images of all directions join the nodes: the renderer then averages mirrored
    cells, which halves the variance for little more time.
    """
    rng, fibers = np.random.default_rng([seed, 11]), scene.fibers.count
    phi = rng.uniform(0.0, np.pi, (count, fibers))
    power = random_colors(count, fibers, rng)
    node = np.tile(np.arange(count)[:, None], (1, fibers))
    if scene.fibers.left != scene.fibers.right or scene.sites.centre_x != 0.0:
        return HeldOutDesigns(scene, phi, power, phi.T, node)
    twin, fiber = mirrored_fibers(scene), np.arange(fibers)
    tip = np.array([edge == "tip" for edge in fiber_edges(scene)])
    # Mirrored sides need equal lists: first the directions of the lower-numbered fiber. At the tip
    # phi becomes pi - phi and the order of the nodes turns round.
    sides = [phi.T[np.minimum(fiber, twin)], phi.T[np.maximum(fiber, twin)]]
    tips = [phi.T, np.pi - phi.T[twin, ::-1]]
    nodes = np.where(tip[:, None], np.concatenate(tips, axis=1), np.concatenate(sides, axis=1))
    return HeldOutDesigns(
        scene, phi, power, nodes, np.where(~tip & (fiber > twin), node + count, node)
    )


@dataclass(frozen=True)
class FrontierRow:
    """One level of the frontier, with its errors on the held-out designs.

    Arguments:
        level: what predicted the designs.
        seconds_per_design: wall time of one design, all bends.
        facet_error_median, facet_error_p95: ``|c - c_ref| / |c_ref|`` of facet colors; the
            reference's own noise is part of them.
        facet_error_true: root mean square of the same with that noise taken out.
        score_error: median ``|S - S_ref|`` in counts.
        kendall_tau: rank agreement of the scores; ``kendall_tau_interval`` holds 95 % of
            resampled sets of designs.
        setup_seconds: spent once, before the first design.
        designs: how many designs the row stands on.
        note: what a reader must know to compare it.
    """

    level: str
    seconds_per_design: float
    facet_error_median: float
    facet_error_p95: float
    facet_error_true: float
    score_error: float
    kendall_tau: float
    kendall_tau_interval: tuple[float, float]
    setup_seconds: float
    designs: int
    note: str


@dataclass(frozen=True)
class HeldOutReference:
    """Counts and scores of the held-out designs at level 2, with their error bars.

    Arguments:
        designs: what was rendered.
        counts, counts_se: ``(design, bend, site, facet, 3)`` and one standard error.
        scores, scores_se: ``(design,)``, freed of the noise's bias by the jackknife.
        exposure, lam: of the scene.
        samples: per fiber and facet.
        replicates: independent groups of chains behind the error bars.
        seconds: of the render.
    """

    designs: HeldOutDesigns
    counts: Array
    counts_se: Array
    scores: Array
    scores_se: Array
    exposure: float
    lam: float
    samples: int
    replicates: int
    seconds: float

    @classmethod
    def of(
        cls, estimate: TransportEstimate, designs: HeldOutDesigns, exposure: float, lam: float
    ) -> HeldOutReference:
        """Return counts and scores with error bars from the replicates of ``estimate``."""
        replicates = np.stack([designs.of_nodes(transport) for transport in estimate.replicates])
        light = np.einsum("rdfbsk,dfc->rdbskc", replicates, designs.power, optimize=True) * exposure
        scores = [
            jackknife(lambda mean: float(scores_of(clip_counts(mean), lam)), light[:, design])
            for design in range(len(designs))
        ]
        counts = image_counts(designs.of_nodes(estimate.T), designs.power, exposure)
        return cls(
            designs=designs,
            counts=np.asarray(counts, dtype=np.float64),
            counts_se=light.std(axis=0, ddof=1) / np.sqrt(len(replicates)),
            scores=np.array([score.value for score in scores]),
            scores_se=np.array([score.se for score in scores]),
            exposure=exposure,
            lam=lam,
            samples=int(str(estimate.settings["samples_per_cell"])),
            replicates=len(replicates),
            seconds=estimate.seconds,
        )

    def row(
        self,
        level: str,
        counts: Array,
        *,
        seconds: float,
        setup: float = 0.0,
        scores: Array | None = None,
        note: str = "",
    ) -> FrontierRow:
        """Return the errors of ``counts`` ``(design, bend, site, facet, 3)``.

        Arguments:
            level: name of the row.
            counts: what the level says.
            seconds: per design.
            setup: seconds spent once.
            scores: ``(design,)``, where the level has better ones than those of its mean counts.
            note: for the reader.
        """
        scores = scores_of(counts, self.lam) if scores is None else scores
        truth = np.linalg.norm(self.counts, axis=-1)
        lit = truth > 0
        error = np.linalg.norm(counts - self.counts, axis=-1)[lit] / truth[lit]
        beyond = error**2 - (self.counts_se**2).sum(axis=-1)[lit] / truth[lit] ** 2
        # The interval of tau is the percentile interval over resampled designs (Efron 1979).
        picks = np.random.default_rng(0).integers(0, len(scores), (RESAMPLES, len(scores)))
        taus = [kendall_tau(scores[pick], self.scores[pick]) for pick in picks]
        tail = 0.5 * (1.0 - 0.95)
        low, high = np.quantile(taus, [tail, 1.0 - tail])
        return FrontierRow(
            level=level,
            seconds_per_design=seconds,
            facet_error_median=float(np.median(error)),
            facet_error_p95=float(np.quantile(error, 0.95)),
            facet_error_true=float(np.sqrt(max(float(beyond.mean()), 0.0))),
            score_error=float(np.median(np.abs(scores - self.scores))),
            kendall_tau=kendall_tau(scores, self.scores),
            kendall_tau_interval=(float(low), float(high)),
            setup_seconds=setup,
            designs=len(counts),
            note=note,
        )

    def noise_row(self, seed: int) -> FrontierRow:
        """Return what a perfect level would show against a reference as noisy as this one."""
        rng = np.random.default_rng([seed, 12])
        noisy = self.counts + self.counts_se * rng.standard_normal(self.counts.shape)
        return self.row(
            "noise of the reference",
            np.clip(noisy, 0.0, None),
            seconds=self.seconds / len(self.scores),
            scores=self.scores + self.scores_se * rng.standard_normal(len(self.scores)),
            note="what a perfect level would show: the reference against itself, noise added once "
            "more",
        )

    def to_json(self) -> dict[str, object]:
        """Return how it was made, how well it is known, and the scores."""
        noise = np.linalg.norm(self.counts_se, axis=-1) / np.linalg.norm(self.counts, axis=-1)
        return {
            "level": "reference (bidirectional, MIS)",
            "sampler": "monte-carlo",
            "samples": self.samples,
            "seed": REFERENCE_SEED,
            "replicates": self.replicates,
            "seconds": self.seconds,
            "designs": len(self.scores),
            "facet_se_median": float(np.median(noise)),
            "facet_se_p95": float(np.quantile(noise, 0.95)),
            "score_se_median": float(np.median(self.scores_se)),
            "scores": self.scores.tolist(),
            "scores_se": self.scores_se.tolist(),
        }

    def coverage(self, checker: Checker) -> Coverage:
        """Return how often the intervals of ``checker`` hold this independent reference.

        They are meant for the reference without its noise. Its own interval of the same coverage,
        by Student's t over its replicates, is added in quadrature: two normal errors would then be
        held exactly as often as stated.
        """
        bends = np.array(self.designs.scene.bending.angles)
        predicted = checker.run(self.designs.phi, self.designs.power, bends)
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
        return coverage(compared, Quantiles(checker.counts_factor, 1.0, checker.score_half_width))


def scores_of(counts: Array, lam: float) -> Array:
    """Return S ``(...)`` of ``counts`` ``(..., bend, site, facet, 3)``."""
    return np.asarray(design_score(site_metric(counts, lam)).score)
