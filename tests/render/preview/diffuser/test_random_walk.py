"""The random walk against tabulated and exact results."""

import numpy as np
import pytest

from render.preview.diffuser.random_walk import Photons, Slab, sample_henyey_greenstein, walk


def pencil(slab: Slab, count: int) -> Photons:
    position = np.tile(np.float32([0.0, 0.0, slab.height / 2]), (count, 1))
    direction = np.tile(np.float32([0.0, 1.0, 0.0]), (count, 1))
    weight = np.full(count, 1 / count, dtype=np.float32)
    return Photons(position, direction, weight, np.arange(count), np.ones(count, dtype=bool))


def test_a_thin_layer_transmits_what_van_de_hulst_tabulated() -> None:
    # Albedo 0.9, g 0.75, optical thickness 2, matched boundaries (van de Hulst 1980, table 35).
    slab = Slab(0.02, 1000.0, 90.0, 10.0, 0.75, 1.0, 0.0)
    left, _ = walk(slab, pencil(slab, 30_000), np.random.default_rng(0))
    assert left.weight.sum() == pytest.approx(0.66096, abs=0.006)
    assert left.weight[left.straight].sum() == pytest.approx(np.exp(-2.0), abs=0.006)


def test_a_clear_layer_lets_light_pass_straight() -> None:
    slab = Slab(2.0, 4.0, 0.0, 0.5, 0.0, 1.41, 0.0)
    left, events = walk(slab, pencil(slab, 10), np.random.default_rng(0))
    assert left.weight.sum() == pytest.approx(np.exp(-1.0), rel=1e-5)
    assert left.straight.all()
    assert events == 10
    np.testing.assert_allclose(left.position[:, 1], 2.0)


def test_without_absorption_no_light_is_lost_in_a_layer_closed_by_reflection() -> None:
    # Index 1000 keeps practically everything in: all light leaves through the inner face.
    slab = Slab(1.0, 2.0, 2.0, 0.0, 0.5, 1000.0, 0.0)
    left, _ = walk(slab, pencil(slab, 5_000), np.random.default_rng(1))
    assert left.weight.sum() == pytest.approx(1.0, abs=0.02)


def test_a_walk_leaves_the_photons_of_its_caller_as_they_are() -> None:
    slab = Slab(1.0, 2.0, 5.0, 0.1, 0.5, 1.41, 0.1)
    photons, untouched = pencil(slab, 100), pencil(slab, 100)
    walk(slab, photons, np.random.default_rng(0))
    for name, values in vars(untouched).items():
        np.testing.assert_array_equal(getattr(photons, name), values)


@pytest.mark.parametrize("g", [-0.9, 0.0, 0.6, 0.99])
def test_scattering_has_the_mean_cosine_g(g: float) -> None:
    before = np.tile(np.float32([0.6, 0.0, -0.8]), (50_000, 1))
    after = sample_henyey_greenstein(before, g, np.random.default_rng(2))
    np.testing.assert_allclose(np.linalg.norm(after, axis=1), 1.0, atol=1e-4)
    assert (before * after).sum(axis=1).mean() == pytest.approx(g, abs=0.01)


def test_every_walk_ends_in_a_thick_layer() -> None:
    slab = Slab(50.0, 50.0, 50.0, 0.0, 0.0, 1.41, 0.0)
    _, events = walk(slab, pencil(slab, 50), np.random.default_rng(3))
    assert events < 50 * 600
