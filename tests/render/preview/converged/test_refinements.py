"""More runs of light paths lower the photon noise; what they find is averaged."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from render.preview.converged import Effort, cache, phi_nodes, refinements, transport_at
from render.progress import Clock, Progress
from render.scene import Scene
from tests.oracles.random_scenes import random_scene

EFFORT = Effort(photons=2000, paths=256, arrivals=200_000, rounds=1)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Return a clear pad that bends."""
    return random_scene(71)


@pytest.fixture(autouse=True)
def _little_effort(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(cache, "EFFORT", EFFORT)


def test_the_noisiest_bend_is_followed_again_and_the_mean_of_its_runs_is_taken(
    scene: Scene,
) -> None:
    first, second = itertools.islice(refinements(scene, 1e-6), 2)
    bends = scene.bending.angles
    assert len(bends) > 1
    noisiest = int(first.noise.argmax())
    again = transport_at(scene, bends[noisiest], phi_nodes(scene), EFFORT, Clock(1, None), seed=1)
    for bend in range(len(bends)):
        mean = first.cells[:, :, bend]
        if bend == noisiest:
            mean = (mean + again.cells) / 2
            assert not np.array_equal(again.cells, first.cells[:, :, bend])
        np.testing.assert_allclose(second.cells[:, :, bend], mean, rtol=1e-12)
    said = np.hypot(first.noise[noisiest], again.noise) / 2
    assert second.noise[noisiest] == pytest.approx(said)
    assert second.grain[:, :, noisiest] == pytest.approx(
        (first.grain[:, :, noisiest] + again.grain) / 4
    )


def test_runs_end_at_the_goal_and_are_kept(scene: Scene) -> None:
    first = next(refinements(scene, 1.0))
    goal = 0.9 * float(first.noise.max())
    *_, last = refinements(scene, goal)
    assert last.noise.max() <= goal < first.noise.max()

    told: list[Progress] = []
    *_, again = refinements(scene, goal, told.append)
    np.testing.assert_array_equal(again.cells, last.cells)
    # Nothing was followed anew: all is done where a run is told of first.
    assert all(at.done == at.total for at in told[len(scene.bending.angles) - 1 :])


def test_a_goal_that_is_met_needs_one_run(scene: Scene) -> None:
    assert len(list(refinements(scene, 1.0))) == 1
