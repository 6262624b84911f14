"""The stages of an exploration: baseline, after the color search, after the directions."""

from __future__ import annotations

from dataclasses import dataclass

from optimize.design.design import Array, Design, Rating


@dataclass(frozen=True, eq=False)
class Stage:
    """A design of one stage with what the surrogate says about it.

    Arguments:
        key: ``baseline``, ``colors`` or ``optimized``; names files.
        title: for people.
        change: what this stage did, to follow "by".
        metric: M of eq. (4.6), ``(bend, site)``.
        counts: what the camera records, ``(bend, site, facet, 3)``.
        clipped: fraction of facets that saturate.
        domain_excess: 0 inside the surrogate's trained range, positive outside.
    """

    key: str
    title: str
    change: str
    design: Design
    rating: Rating
    metric: Array
    counts: Array
    clipped: float
    domain_excess: float
