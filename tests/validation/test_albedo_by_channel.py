"""Skins with an albedo per channel against analog photons, followed once for each albedo.

From the command line: ``python -m tests.validation.test_albedo_by_channel [CASE ...]``.
"""

from __future__ import annotations

import sys

import numpy as np
import pytest

from render.preview.converged import Effort, task_count, transport_at
from render.progress import Clock
from render.reference import render_transport
from render.scene import Scene
from tests.colored_skins import skin_of
from tests.long import LONG
from tests.oracles.analog_cells import AnalogScene

PHI = 1.2
SAMPLES = 2000 if LONG else 300
PHOTONS = 20_000_000 if LONG else 1_000_000
EFFORT = Effort() if LONG else Effort(photons=20_000, paths=4096, arrivals=1_000_000)


def by_photons(scene: Scene, fiber: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the sum over facets by channel ``(channel,)``, and its standard error."""
    sums = []
    for one in scene.one_albedo_scenes:
        cells = AnalogScene(one, views=4000).cells(fiber, PHI, PHOTONS)
        sums.append(np.nansum(cells.replicates, axis=1))
    found = np.array(sums)
    return found.mean(axis=1), found.std(axis=1, ddof=1) / np.sqrt(found.shape[1])


def rendered(scene: Scene, fiber: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the same at level 2."""
    found = render_transport(
        scene, np.array([PHI]), np.zeros(1), samples=SAMPLES, seeds=(1,), replicates=16
    )
    sums = found.replicates[:, fiber, 0, 0].sum(axis=(1, 2))
    return sums.mean(axis=0), sums.std(axis=0, ddof=1) / np.sqrt(len(sums))


def followed(scene: Scene, fiber: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the same of traced light, known to 1 % without its photons' noise."""
    clock = Clock(task_count(scene, EFFORT), None)
    found = transport_at(scene, 0.0, np.array([PHI]), EFFORT, clock)
    sums = found.cells[fiber, 0, :, :-1].sum(axis=(0, 1))
    return sums, 0.02 * sums


@pytest.mark.parametrize("light", [rendered, followed])
@pytest.mark.parametrize("case", ["smooth", "rough 0.1"])
def test_each_channel_is_what_photons_of_its_albedo_say(light: object, case: str) -> None:
    scene = skin_of(case=case)
    for fiber in range(scene.lamp_count):
        truth, known = by_photons(scene, fiber)
        found, error = light(scene, fiber)  # type: ignore[operator]
        ratio = found / truth
        uncertain = np.hypot(error / found, known / truth)
        assert (np.abs(ratio - 1.0) < 4.0 * uncertain + 0.01).all(), (ratio, uncertain)
        # Of the light of another albedo, channels are off by far more than they may be.
        assert np.abs(found[[1, 2, 0]] / truth - 1.0).min() > 0.25


def told(case: str) -> None:
    """Print light over photons, channel by channel."""
    scene = skin_of(case=case)
    for fiber in range(scene.lamp_count):
        truth, known = by_photons(scene, fiber)
        for light in (rendered, followed):
            found, error = light(scene, fiber)
            ratio, uncertain = found / truth, np.hypot(error / found, known / truth)
            shown = ", ".join(f"{r:.3f} +- {u:.3f}" for r, u in zip(ratio, uncertain, strict=True))
            print(f"{case}, lamp {fiber}, {light.__name__}: {shown}", flush=True)


if __name__ == "__main__":
    for name in sys.argv[1:] or ("smooth", "rough 0.1"):
        told(name)
