"""What a round of the verification loop renders: the best, the most uncertain and a random design.

The surrogate proposes. Its best design alone would never show where it is wrong, so the most
uncertain of the next-best ones and one random design are rendered with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optimize.colors.quick import quick_colours
from optimize.colors.result import renamed_like
from optimize.design import Array, Design
from optimize.evaluate import TableScorer
from optimize.joint import optimise_jointly
from optimize.polish import polish
from optimize.score_noise import TIE_DRAWS, score_draws

ALTERNATIVES = 8
"""Next-best colourings that get directions of their own."""
SAME_ANGLE = np.radians(1.0)
"""Directions that differ by less are the same design."""
RUNS = (1, 2, 4)


@dataclass(frozen=True, eq=False)
class Proposal:
    """A design that is to be rendered, and what the surrogate expects of it.

    Arguments:
        role: ``baseline``, ``best``, ``uncertain``, ``random`` or ``incumbent``.
        design: the design.
        predicted: its score S on the surrogate, in counts.
        spread: one standard deviation of that prediction.
    """

    role: str
    design: Design
    predicted: float
    spread: float


def propose(
    scorer: TableScorer,
    start: Design,
    *,
    edges: Sequence[str],
    seed: int,
    known: Sequence[Design] = (),
) -> list[Proposal]:
    """Return the best, the most uncertain and one random design, without those known.

    Arguments:
        scorer: the surrogate's table as it stands.
        start: where the search begins.
        edges: the side of each fiber.
        seed: of the search and of the random design.
        known: designs that were rendered before; they are not proposed again.
    """
    best = optimise_jointly(scorer, start, edges=edges, seed=seed).design
    colourings = quick_colours(scorer, best.phi, starts=[best.colours], seed=seed).top
    others = []
    for colours, _ in colourings[: ALTERNATIVES + 1]:
        named = np.array(colours)
        if scorer.colours_alike:
            named = renamed_like(named, best.colours)
        power = scorer.power(named)
        if np.array_equal(power, best.power):
            continue
        others.append(polish(scorer, Design(best.phi, power)).design)
    chosen = [described(scorer, "best", best)]
    rest = [described(scorer, "uncertain", design) for design in others]
    chosen += [max(rest, key=lambda entry: entry.spread)] if rest else []
    chosen.append(described(scorer, "random", random_design(scorer, seed)))
    return [p for p in chosen if not any(same_design(p.design, old) for old in known)]


def described(scorer: TableScorer, role: str, design: Design) -> Proposal:
    """Return the proposal of ``design`` with score and spread on ``scorer``'s table."""
    score = scorer.score(design.phi, design.power)
    spread = 0.0
    if scorer.table.se.any():
        drawn = score_draws(scorer, design.phi, design.power[None], TIE_DRAWS)
        spread = float(drawn.std(ddof=1))
    return Proposal(role, design, score, spread)


def random_design(scorer: TableScorer, seed: int) -> Design:
    """Return a random design; neighbouring fibers share a colour in runs of 1, 2 or 4."""
    rng = np.random.default_rng([seed, 5])
    run = int(rng.choice(RUNS))
    colours = np.repeat(rng.integers(0, 3, -(-scorer.fibers // run)), run)[: scorer.fibers]
    low, high = scorer.phi_bounds
    phi: Array = np.asarray(rng.uniform(low, high, scorer.fibers))
    return scorer.limits.obeyed(Design(phi, scorer.power(colours)))


def same_design(first: Design, second: Design) -> bool:
    """Return whether two designs differ by less than can be mounted."""
    turned: Array = np.abs(first.phi - second.phi)
    return bool(np.allclose(first.power, second.power) and turned.max() < SAME_ANGLE)
