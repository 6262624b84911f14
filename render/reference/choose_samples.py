"""How many samples a time gives, and in how many passes so many are made.

Every pass is traced anew, and a render goes on by whole passes (``render.reference.budget``).
"""

from __future__ import annotations

import math

from render.cells.choose_sampler import STRATA
from render.geometry import counted_sites
from render.reference.job import CHUNK, Sampler
from render.scene import Scene

MIN_CHAINS, MAX_CHAINS = 64, 16384
MIN_ITERATIONS = 24
MAX_SUBPATHS = 1 << 18
"""Camera subpaths of one pass for all lamps at once, as long as every replicate has a sample."""
PASS_DIVISORS = ((16.0, 1), (4.0, 4), (0.0, 16))
"""Seconds per job from which a pass is a full one, or a part of it: passes of 16384 paths last up
to a second, and a time is filled only as finely as the passes of all jobs together."""


def samples_per_pass(scene: Scene, seconds: float, jobs: int) -> int:
    """Return samples per cell and pass, few enough that ``jobs`` fill ``seconds`` finely."""
    divisor = next(part for least, part in PASS_DIVISORS if max(seconds, 0.0) >= least * jobs)
    return max(1, samples_of_full_pass(scene) // divisor)


def samples_of_full_pass(scene: Scene) -> int:
    """Return the samples per cell that fill one pass of MAX_CHAINS paths."""
    return max(1, MAX_CHAINS // (len(counted_sites(scene)) * scene.lamp_count))


def lamp_by_lamp_shape(
    count: int, pairs: int, sampler: Sampler, per_pass: int | None, effort: float
) -> tuple[int, int]:
    """Return chains and iterations for about ``effort * count`` samples of each of ``pairs``.

    Every pass is traced anew, which takes as long as thousands of paths: independent paths take
    the fewest passes. Chains need their passes, to move away from where they started.
    """
    total = effort * count * pairs
    if sampler == "monte-carlo":
        if per_pass is None:
            passes = math.ceil(total / MAX_CHAINS)
        else:
            passes = math.ceil(count / per_pass)
            if effort > 1.0:  # several passes where one would be too large, by more than a half
                passes *= max(1, round(total / passes / MAX_CHAINS))
        return MIN_CHAINS * max(1, round(total / passes / MIN_CHAINS)), passes
    chains = MAX_CHAINS
    while chains > MIN_CHAINS and total < MIN_ITERATIONS * chains:
        chains //= 2
    return chains, CHUNK * max(1, round(total / chains / CHUNK))


def shared_shape(
    scene: Scene, samples: int, replicates: int, per_pass: int | None, *, indented: bool
) -> tuple[int, int]:
    """Return lanes and passes for about ``samples`` camera subpaths of every facet.

    Every replicate has as many lanes as the others; ``per_pass`` as of ``transport_jobs``.
    """
    targets = len(counted_sites(scene)) * (scene.indenter.faces if indented else 1)
    most = max(1, MAX_SUBPATHS // (targets * STRATA * replicates))
    groups = samples / STRATA / replicates
    passes = math.ceil(samples / per_pass if per_pass else groups / most)
    return replicates * max(1, round(groups / passes)), passes
