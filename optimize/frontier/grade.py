"""How wrong a level is: its colors and scores of the held-out designs against the reference."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from optimize.frontier.reference import Reference
from render.arrays import Array
from render.metric import design_score, site_metric
from surrogate.training.evaluation import kendall_tau

RESAMPLES = 1000


@dataclass(frozen=True)
class Row:
    """One level of the frontier.

    Arguments:
        level: what judged the designs.
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

    def to_json(self) -> dict[str, object]:
        """Return the row for programs."""
        return asdict(self)


def grade(
    reference: Reference,
    level: str,
    counts: Array,
    *,
    seconds: float,
    setup: float = 0.0,
    scores: Array | None = None,
    noise: Array | None = None,
    note: str = "",
) -> Row:
    """Return the errors of ``counts`` ``(design, bend, site, facet, 3)``.

    Arguments:
        reference: the answers.
        level: name of the row.
        counts: what the level says.
        seconds: per design.
        setup: seconds spent once.
        scores: ``(design,)``, where the level has better ones than those of its mean counts.
        noise: standard error of ``counts`` that is not held against the level, as in the row of
            the reference's own noise.
        note: for the reader.
    """
    found = score_of(counts, reference.lam) if scores is None else scores
    truth = np.linalg.norm(reference.counts, axis=-1)
    lit = truth > 0
    off = np.linalg.norm(counts - reference.counts, axis=-1)[lit] / truth[lit]
    known = reference.counts_se if noise is None else noise
    beyond = off**2 - (known**2).sum(axis=-1)[lit] / truth[lit] ** 2
    return Row(
        level=level,
        seconds_per_design=seconds,
        facet_error_median=float(np.median(off)),
        facet_error_p95=float(np.quantile(off, 0.95)),
        facet_error_true=float(np.sqrt(max(float(beyond.mean()), 0.0))),
        score_error=float(np.median(np.abs(found - reference.scores))),
        kendall_tau=kendall_tau(found, reference.scores),
        kendall_tau_interval=_tau_interval(found, reference.scores),
        setup_seconds=setup,
        designs=len(counts),
        note=note,
    )


def score_of(counts: Array, lam: float) -> Array:
    """Return S ``(design,)`` of ``counts`` ``(design, bend, site, facet, 3)``."""
    return np.asarray(design_score(site_metric(counts, lam)).score)


def noise_row(reference: Reference, seed: int) -> Row:
    """Return what a perfect level would show against a reference as noisy as this one."""
    rng = np.random.default_rng([seed, 12])
    noisy = reference.counts + reference.counts_se * rng.standard_normal(reference.counts.shape)
    scores = reference.scores + reference.scores_se * rng.standard_normal(len(reference.scores))
    return grade(
        reference,
        "noise of the reference",
        np.clip(noisy, 0.0, None),
        seconds=reference.seconds / len(reference.scores),
        scores=scores,
        note="what a perfect level would show: the reference against itself, noise added once more",
    )


def _tau_interval(a: Array, b: Array) -> tuple[float, float]:
    """Return the 95 % percentile interval over resampled designs (Efron 1979)."""
    rng = np.random.default_rng(0)
    picks = rng.integers(0, len(a), (RESAMPLES, len(a)))
    taus = [kendall_tau(a[pick], b[pick]) for pick in picks]
    tail = 0.5 * (1.0 - 0.95)
    low, high = np.quantile(taus, [tail, 1.0 - tail])
    return float(low), float(high)
