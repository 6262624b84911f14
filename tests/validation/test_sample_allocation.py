"""What it is worth to put samples where they move the scores: variance times processor time.

``python -m tests.validation.test_sample_allocation SCENE --samples N --seeds K`` prints a table.
The variance is that of the jackknife over 64 independent groups of paths a seed.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
import pytest

from optimize.design import Array, Design, ScoreSettings, dimmed_baseline, limits_of
from optimize.scoring import (
    TableScorer,
    open_model,
    paired_difference,
    rendered_score,
    search_table,
)
from optimize.search import alternating_search
from optimize.verification import distinct_directions, score_allocation
from render.geometry import fiber_edges
from render.reference import EVERYTHING, PRESSED, SampleAllocation, ensure_llvm, render_transport
from render.scene import Scene, load_scene
from render.transport import TransportTable
from tests.oracles.random_scenes import random_scene

GROUPS = 64
WAYS = ("apart, untouched pads too", "together, pressed pads", "samples where they matter")


@dataclass(frozen=True)
class Cost:
    """Variances of the difference and of both scores, and seconds of the processor."""

    difference: float
    baseline: float
    design: float
    seconds: float

    def gains(self, before: Cost) -> tuple[float, float, float]:
        """Return how many times less variance there is at equal time than ``before``."""
        pairs = zip(vars(before).values(), vars(self).values(), strict=True)
        *variances, (slow, fast) = pairs
        first, second, third = (slow * a / (fast * max(b, 1e-30)) for a, b in variances)
        return first, second, third


def pair_of(scene: Scene) -> tuple[TransportTable, list[Design]]:
    """Return the model's table, the baseline and the best design on it."""
    table = search_table(open_model(scene))
    base = dimmed_baseline(scene)
    scorer = TableScorer(table, limits=limits_of(scene))
    found = alternating_search(scorer, base, edges=fiber_edges(scene), seed=0)
    return table, [base, found.design]


def cost_of(
    way: str, scene: Scene, table: TransportTable, pair: list[Design], samples: int, seeds: int
) -> Cost:
    """Return what renders of ``pair`` cost in that way."""
    settings, bends = ScoreSettings(table.exposure, table.lam), np.array(scene.bending.angles)

    def replicates(phi: Array, allocation: SampleAllocation) -> Array:
        found = render_transport(
            scene, phi, bends, samples=samples, seeds=range(1, seeds + 1), replicates=GROUPS,
            allocation=allocation,
        )  # fmt: skip
        return found.replicates

    began = time.process_time()
    phi, node = distinct_directions(pair)
    if way == WAYS[0]:
        parts = [replicates(column[:, None], EVERYTHING) for column in phi.T]
        transport = np.concatenate(parts, axis=2)
    else:
        allocation = PRESSED
        if way == WAYS[2]:
            allocation = score_allocation(scene, table, settings, pair, leader=1)
        transport = replicates(phi, allocation)
    first, second = (transport[:, :, index] for index in node)
    low, high = (design.power for design in pair)
    scores = (
        paired_difference(settings, first, low, second, high),
        rendered_score(settings, first, low).score,
        rendered_score(settings, second, high).score,
    )
    seconds = time.process_time() - began
    return Cost(*(score.sampling**2 for score in scores), seconds)


@pytest.mark.slow
def test_samples_where_they_matter_are_worth_it() -> None:
    ensure_llvm()
    scene = load_scene("finger20")
    table, pair = pair_of(scene)
    before, after = (cost_of(way, scene, table, pair, 96, 1) for way in (WAYS[0], WAYS[2]))
    # Measured 4; of 64 groups a ratio of variances is known to a factor of 1.6.
    assert after.gains(before)[0] > 2.0


def main() -> None:
    """Print variances, seconds and gains."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", help="name or file of a scene, or random-NUMBER")
    parser.add_argument("--samples", type=int, default=96)
    parser.add_argument("--seeds", type=int, default=1)
    asked = parser.parse_args()
    name = asked.scene
    scene = random_scene(int(name[7:])) if name.startswith("random-") else load_scene(name)
    ensure_llvm()
    table, pair = pair_of(scene)
    before = None
    for way in WAYS:
        cost = cost_of(way, scene, table, pair, asked.samples, asked.seeds)
        before = before or cost
        gains = ", ".join(f"{gain:.2f}" for gain in cost.gains(before))
        errors = np.sqrt([cost.difference, cost.baseline, cost.design])
        print(
            f"{way}: se of difference, baseline, design {errors.round(2).tolist()}, "
            f"{cost.seconds:.1f} s, gains {gains}"
        )


if __name__ == "__main__":
    main()
