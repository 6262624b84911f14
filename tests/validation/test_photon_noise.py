"""The photon noise that converged light says of its colors, against runs with other seeds.

From the command line, a line for every bend of random sensors (``tests.oracles.random_scenes``):
``python -m tests.validation.test_photon_noise 1 5 7 --arrivals 4000000`` follows so many photons
once for each of two seeds; without ``--arrivals`` as many as `explore` does, with one seed.
"""

from __future__ import annotations

import argparse
import math

import numpy as np
import pytest

from render.preview.converged import (
    ConvergedTransport,
    Effort,
    phi_nodes,
    task_count,
    transport_at,
)
from render.preview.converged.color_noise import Halved, color_noise
from render.progress import Clock
from render.scene import Scene
from tests.long import LONG
from tests.oracles.random_scenes import random_scene

ARRIVALS = 4_000_000


def few_photons(arrivals: int) -> Effort:
    return Effort(photons=20_000, paths=4096, arrivals=arrivals, rounds=1)


def two_runs(scene: Scene, bend: float, effort: Effort) -> list[ConvergedTransport]:
    return [
        transport_at(scene, bend, phi_nodes(scene), effort, Clock(1, None), seed) for seed in (0, 1)
    ]


def by_seeds(runs: list[ConvergedTransport]) -> float:
    """Return the color noise of one run by the difference of two."""
    first, second = (run.cells[..., :-1] for run in runs)
    return color_noise(Halved((first + second) / 2, (first - second) / math.sqrt(2.0)), 3)


@pytest.mark.slow
@pytest.mark.parametrize("sensor", [1, 5, 7] if LONG else [5])
def test_two_seeds_differ_by_the_noise_that_is_said(sensor: int) -> None:
    scene = random_scene(sensor)
    for bend in scene.bending.angles:
        runs = two_runs(scene, bend, few_photons(ARRIVALS))
        said = math.sqrt(np.mean([float(run.noise) ** 2 for run in runs]))
        assert 0.75 < said / by_seeds(runs) < 1.35


def main() -> None:
    """Print what is said of random sensors, and what two seeds differ by."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sensors", nargs="+", type=int)
    parser.add_argument("--arrivals", type=int)
    asked = parser.parse_args()
    for sensor in asked.sensors:
        scene = random_scene(sensor)
        for bend in scene.bending.angles:
            name = f"random-{sensor}, {math.degrees(bend):.0f} deg:"
            if asked.arrivals:
                runs = two_runs(scene, bend, few_photons(asked.arrivals))
                said = ", ".join(f"{float(run.noise):.2%}" for run in runs)
                print(name, f"said {said}; by two seeds {by_seeds(runs):.2%}", flush=True)
                continue
            effort = Effort()
            clock = Clock(task_count(scene, effort), None)
            found = transport_at(scene, bend, phi_nodes(scene), effort, clock)
            more = clock.total / task_count(scene, effort)
            print(name, f"said {float(found.noise):.2%}; {more:.2f} times the work", flush=True)


if __name__ == "__main__":
    main()
