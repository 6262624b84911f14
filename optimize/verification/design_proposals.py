"""What a round of the verification loop renders: the best, its likeliest rival, a random design.

The surrogate proposes. Its best design alone would never show where it is wrong, so two others are
rendered with it: of the next-best ones the one that is expected to gain most over the best by the
surrogate's own errors (expected improvement: Mockus 1978, Jones, Schonlau and Welch 1998), and a
random one. What counts is the error of the difference: designs that are alike share theirs.
Errors of the surrogate are known for S alone: for a reader the next-best design is the rival.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optimize.design import Array, Colors, Design, ScoredDesign
from optimize.scoring import TIE_DRAWS, TableScorer, score_draws
from optimize.search import Objective, refine_by, refine_locally
from optimize.search.colors import canonical, quick_colors, renamed_like
from optimize.verification.judges import Judge

ALTERNATIVES = 8
"""Next-best colorings that get directions of their own: local optima, then neighbors."""
SAME_ANGLE = np.radians(1.0)
"""Directions that differ by less are the same design."""
COLOR_RUNS = (1, 2, 4)
"""How many neighboring fibers of a random design share a color."""
MIRROR_TOLERANCE = 1e-4
"""Relative difference of score below which mirrored colors mean a mirrored design."""


@dataclass(frozen=True, eq=False)
class Proposal(ScoredDesign):
    """A design that is to be rendered, with the judge's figure on the surrogate as its score.

    Arguments:
        role: ``baseline``, ``first``, ``incumbent``, ``best``, ``uncertain`` (the likeliest rival)
            or ``random``.
        spread: one standard deviation of S; 0 where it is not known.
    """

    role: str
    spread: float


def propose(
    scorer: TableScorer,
    start: Design,
    judge: Judge,
    *,
    seed: int,
    known: Sequence[Design] = (),
) -> list[Proposal]:
    """Return the best, its likeliest rival and one random design, without those known.

    Arguments:
        scorer: the surrogate's table as it stands.
        start: where the search begins.
        judge: says what is better.
        seed: of the search and of the random design.
        known: designs that were rendered before; they are not proposed again.
    """
    goal, by_score = judge.on_table(scorer), judge.objective == "score"
    best = judge.search(scorer, start, seed)
    colorings: list[Colors] = []
    if by_score:
        top = quick_colors(scorer, best.phi, starts=[best.colors], seed=seed).top
        colorings = [np.array(row) for row, _ in top[: ALTERNATIVES + 1]]
    others: list[Design] = []
    for colors in [*colorings, *_recolored(scorer, goal, best)]:
        if len(others) == ALTERNATIVES:
            break
        if scorer.colors_alike:
            colors = renamed_like(colors, best.colors, len(scorer.palette.names))
        recolored = scorer.design(best.phi, colors)
        if np.array_equal(recolored.drive, best.drive):
            continue
        near = refine_locally(scorer, recolored) if by_score else refine_by(scorer, goal, recolored)
        if not _is_mirror_image(scorer, goal, near.design, best):
            others.append(near.design)
    # A recolored neighbor may reach further than the search did.
    found = sorted([best, *others], key=goal.value, reverse=True)
    best, others = found[0], found[1:]
    chosen = [proposal_of(scorer, judge, "best", best)]
    if others:

        def promise(design: Design) -> float:
            return expected_improvement(scorer, design, best) if by_score else goal.value(design)

        chosen.append(proposal_of(scorer, judge, "uncertain", max(others, key=promise)))
    chosen.append(proposal_of(scorer, judge, "random", random_design(scorer, seed)))
    return [p for p in chosen if not any(same_design(p.design, old) for old in known)]


def _recolored(scorer: TableScorer, goal: Objective, best: Design) -> list[Colors]:
    """Return the allowed colorings that differ in one fiber from ``best``, best first.

    Fibers that are tied count as one.
    """
    limits = scorer.limits
    if not limits.fits(best.colors[None])[0]:
        return []
    groups, choices = limits.groups, limits.allowed.shape[1]
    moving = np.repeat(np.arange(groups.max() + 1), choices - 1)[:, None]
    step = 1 + np.arange(len(moving)) % max(choices - 1, 1)
    moved = limits.colors_of((best.colors + (groups == moving) * step[:, None]) % choices)
    moved = moved[limits.fits(moved)]
    values = goal.values([scorer.design(best.phi, colors) for colors in moved])
    return list(moved[np.argsort(-values, kind="stable")])


def _is_mirror_image(scorer: TableScorer, goal: Objective, first: Design, second: Design) -> bool:
    """Return whether one design is the other seen in a mirror, so that it would tie for certain.

    Fibers are numbered around the pad, so a mirror reverses their order; equal figures say that
    the sensor is symmetric.
    """
    if not scorer.colors_alike or (first.colors < 0).any() or (second.colors < 0).any():
        return False
    scores = goal.values([first, second])
    reversed_ = canonical(first.colors[None, ::-1])[0]
    alike = np.array_equal(reversed_, canonical(second.colors[None])[0])
    return alike and abs(scores[0] - scores[1]) < MIRROR_TOLERANCE * abs(scores[1])


def proposal_of(scorer: TableScorer, judge: Judge, role: str, design: Design) -> Proposal:
    """Return the proposal of ``design`` with figure and spread on ``scorer``'s table."""
    score = judge.on_table(scorer).value(design)
    spread = 0.0
    if scorer.table.se.any() and judge.objective == "score":
        drawn = score_draws(scorer, design.phi, design.power[None], TIE_DRAWS)
        spread = float(drawn.std(ddof=1))
    return Proposal(design, score, role, spread)


def expected_improvement(scorer: TableScorer, design: Design, best: Design) -> float:
    """Return the mean over tables as likely as ``scorer``'s of what S gains over ``best``, or 0.

    Both designs are scored on the same tables, so what they share cancels; without errors it is
    the plain difference, which ranks designs behind the best too.
    """
    if not scorer.table.se.any():
        return scorer.score(design.phi, design.power) - scorer.score(best.phi, best.power)
    drawn, leading = (
        score_draws(scorer, one.phi, one.power[None], TIE_DRAWS)[:, 0] for one in (design, best)
    )
    return float(np.maximum(drawn - leading, 0.0).mean())


def random_design(scorer: TableScorer, seed: int) -> Design:
    """Return a random design; neighboring fibers share a color in runs of 1, 2 or 4."""
    rng = np.random.default_rng([seed, 5])
    run = int(rng.choice(COLOR_RUNS))
    drawn = rng.integers(0, scorer.limits.allowed.shape[1], -(-scorer.fibers // run))
    colors = scorer.limits.colors_of(np.repeat(drawn, run)[: scorer.fibers])
    low, high = scorer.phi_bounds
    phi: Array = np.asarray(rng.uniform(low, high, scorer.fibers))
    return scorer.limits.nearest_design(scorer.design(phi, colors))


def same_design(first: Design, second: Design) -> bool:
    """Return whether two designs differ by less than can be mounted."""
    turned: Array = np.abs(first.phi - second.phi)
    return bool(np.allclose(first.drive, second.drive) and turned.max() < SAME_ANGLE)
