"""The photon noise that converged light says of itself, against runs with other seeds."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from render.preview.converged import ConvergedTransport, Effort, task_count, transport, transport_at
from render.preview.converged.color_noise import (
    DIM,
    NOISE_LIMIT,
    Halved,
    color_noise,
    halved_product,
)
from render.progress import Clock, Progress
from render.scene import Scene, unchecked
from tests.oracles.random_scenes import random_scene
from tests.small_scenes import small_scene

PHI = np.array([0.8, np.pi / 2, 2.1])
FLAT = {"angles": {"value": [0.0], "unit": "deg", "source": "flat"}}
SEEDS = 8


def clear() -> Scene:
    return unchecked(small_scene(bending=FLAT), {"diffuser": None})


def followed(scene: Scene, bend: float, effort: Effort, seed: int = 0) -> ConvergedTransport:
    return transport_at(scene, bend, PHI, effort, Clock(1, None), seed)


def spread(cells: np.ndarray) -> float:
    """Return the noise of runs ``(seed, lamp, node, site, facet)`` about their mean."""
    mean = cells.mean(axis=0)
    squares = [color_noise(Halved(mean, each - mean), 3) ** 2 for each in cells]
    return math.sqrt(sum(squares) / (len(cells) - 1))


@pytest.mark.parametrize(
    ("scene", "bend", "effort"),
    [
        (clear(), 0.0, Effort(paths=1024, arrivals=400_000, rounds=1)),
        (small_scene(bending=FLAT), 0.0, Effort(photons=10_000, paths=512, rounds=1)),
        (random_scene(71), np.pi / 3, Effort(paths=256, arrivals=3_000_000, rounds=1)),
    ],
    ids=["clear", "thick and milky", "bent"],
)
@pytest.mark.slow
def test_the_noise_is_what_runs_with_other_seeds_differ_by(
    scene: Scene, bend: float, effort: Effort
) -> None:
    runs = [followed(scene, bend, effort, seed) for seed in range(SEEDS)]
    truth = spread(np.stack([run.cells[..., :-1] for run in runs]))
    said = np.array([run.noise for run in runs])
    # Evenly spread starts are better than their halves say, by 2 in the variance at most.
    assert 0.85 < math.sqrt(np.mean(said**2)) / truth < 1.5
    assert 0.6 < said.min() / truth < said.max() / truth < 1.7


def test_halves_of_normal_noise_say_its_deviation() -> None:
    rng, shape = np.random.default_rng(0), (9, 2, 12, 8)
    halves = rng.normal(1.0, 0.1, (2, *shape))
    cells = Halved(halves.mean(axis=0), (halves[0] - halves[1]) / 2)
    # Nine lamps in one channel.
    assert color_noise(cells, 1) == pytest.approx(0.1 / math.sqrt(2) / math.sqrt(9), rel=0.1)


def test_facets_that_are_all_but_dark_do_not_count() -> None:
    whole = np.ones((3, 1, 10, 6))
    dim = whole.copy()
    dim[:, :, 0, 0] = 0.9 * DIM
    noise = 0.01 * whole
    noise[:, :, 0, 0] = 1.0
    assert color_noise(Halved(dim, noise), 1) == pytest.approx(0.01, rel=1e-12)


def test_without_any_light_nothing_is_known() -> None:
    assert color_noise(Halved(np.zeros((3, 1, 2, 6)), np.zeros((3, 1, 2, 6))), 3) == 1.0


def test_the_halves_of_a_product_are_the_products_of_halves() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 4, 5)), rng.normal(size=(2, 5, 3))
    found = halved_product(*(Halved(sum(x) / 2, (x[0] - x[1]) / 2) for x in (a, b)))
    np.testing.assert_allclose(found.difference, (a[0] @ b[0] - a[1] @ b[1]) / 2, atol=1e-12)


def test_where_colors_are_noisy_photons_are_followed_up_to_three_times(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene, effort, told = clear(), Effort(paths=256, arrivals=60_000), list[Progress]()
    clock = Clock(task_count(scene, effort), told.append)
    thrice = transport_at(scene, 0.0, PHI, effort, clock)
    assert clock.done == clock.total > task_count(scene, effort)
    assert all(one.done < two.done for one, two in pairwise(told))
    once = followed(scene, 0.0, replace(effort, rounds=1))
    assert once.noise > NOISE_LIMIT
    assert thrice.noise == pytest.approx(once.noise / math.sqrt(effort.rounds), rel=0.2)
    assert thrice.grain.sum() == pytest.approx(once.grain.sum() / effort.rounds, rel=0.1)
    # The first photons are the same, and the second ones.
    twice = followed(scene, 0.0, replace(effort, rounds=2))
    assert thrice.noise < twice.noise < once.noise
    monkeypatch.setattr(transport, "NOISE_LIMIT", 1.01 * float(twice.noise))
    np.testing.assert_array_equal(followed(scene, 0.0, effort).cells, twice.cells)
    monkeypatch.setattr(transport, "NOISE_LIMIT", 1.01 * float(once.noise))
    clock = Clock(task_count(scene, effort), None)
    np.testing.assert_array_equal(transport_at(scene, 0.0, PHI, effort, clock).cells, once.cells)
    assert clock.done == clock.total == task_count(scene, effort)


def test_where_no_photon_flies_to_the_facets_none_is_followed_again() -> None:
    scene = small_scene(bending=FLAT)
    effort = Effort(photons=400, paths=64)
    clock = Clock(task_count(scene, effort), None)
    assert transport_at(scene, 0.0, PHI, effort, clock).noise > NOISE_LIMIT
    assert clock.total == task_count(scene, effort)
