"""CMA-ES over stepped values: which combination is best, without looking at all of them.

CMA-ES moves in the numbers of the values (Hansen 2016; integer handling as of Hamano et al. 2022);
what it proposes is rounded, and no combination is asked for twice. From the best one, single steps
are taken until none is better, so that the result is at least the best of its neighbors.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Iterator, Sequence

import numpy as np

Point = tuple[int, ...]
"""Number of the value that each dimension takes."""
FIRST_STEP = 0.25
"""Standard deviation of the first generation, in ranges."""
IDLE_GENERATIONS = 4
"""Generations without anything new, after which CMA-ES has converged."""


def stepped_search(
    loss: Callable[[Point], float],
    sizes: Sequence[int],
    start: Point,
    *,
    most: int,
    allowed: Callable[[Point], bool] = lambda _: True,
    seed: int = 0,
) -> dict[Point, float]:
    """Return the losses of all points that were looked at, at most ``most``.

    Arguments:
        loss: of an allowed point; the same for the same point.
        sizes: values of each dimension, of which at least two have several.
        start: first point, allowed.
        most: points that may be looked at.
        allowed: whether there is a sensor at a point.
        seed: of CMA-ES.
    """
    import cma

    known = {start: loss(start)}

    def ask(point: Point) -> float | None:
        """Return the loss of a point, None where there is no sensor or no more time."""
        if point not in known and allowed(point) and len(known) < most:
            known[point] = loss(point)
        return known.get(point)

    moving = [number for number, size in enumerate(sizes) if size > 1]
    ranges = np.array([sizes[number] - 1 for number in moving], dtype=np.float64)
    options = {
        "bounds": [[-0.5] * len(moving), (ranges + 0.5).tolist()],
        "CMA_stds": ranges.tolist(),
        "integer_variables": list(range(len(moving))),
        "seed": seed + 1,  # 0 would be the time of day
        "verbose": -9,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        strategy = cma.CMAEvolutionStrategy(
            [float(start[number]) for number in moving], FIRST_STEP, options
        )
        idle = 0
        # A third is kept for the steps to neighbors.
        while len(known) < most - most // 3 and idle < IDLE_GENERATIONS and not strategy.stop():
            before = len(known)
            asked = strategy.ask()
            points = [_rounded(row, start, moving, sizes) for row in asked]
            losses = [ask(point) for point in points]
            worst = max(known.values()) + 1.0
            strategy.tell(asked, [worst if one is None else one for one in losses])
            idle = idle + 1 if len(known) == before else 0
    while len(known) < most:
        best = min(known, key=lambda point: known[point])
        for point in _neighbors(best, sizes):
            ask(point)
        if min(known, key=lambda point: known[point]) == best:
            break
    return known


def _rounded(
    row: Sequence[float], start: Point, moving: Sequence[int], sizes: Sequence[int]
) -> Point:
    point = list(start)
    for number, value in zip(moving, row, strict=True):
        point[number] = int(np.clip(round(float(value)), 0, sizes[number] - 1))
    return tuple(point)


def _neighbors(point: Point, sizes: Sequence[int]) -> Iterator[Point]:
    """Yield the points one step away, diagonals too: dimensions trade against each other."""
    steps = itertools.product((-1, 0, 1), repeat=len(point))
    near = sorted(steps, key=lambda step: sum(map(abs, step)))
    for step in near:
        moved = tuple(at + by for at, by in zip(point, step, strict=True))
        if any(step) and all(0 <= at < size for at, size in zip(moved, sizes, strict=True)):
            yield moved
