"""Fresnel, Snell and the Beckmann face against closed forms."""

import numpy as np
import pytest

from render.geometry import fresnel, sample_rough_face
from render.geometry.microfacets import shadowing

N = 1.41


def coming(cosine: float, count: int = 20_000) -> np.ndarray:
    direction = np.array([np.sqrt(1 - cosine**2), -cosine, 0.0], dtype=np.float32)
    return np.tile(direction, (count, 1))


def test_normal_incidence_reflects_as_the_textbook_says() -> None:
    assert fresnel(np.ones(1), N)[0][0] == pytest.approx(((N - 1) / (N + 1)) ** 2)


def test_reflectance_is_the_same_from_both_sides() -> None:
    outside = np.array([0.9, 0.5, 0.1])
    reflected, inside = fresnel(outside, N)
    np.testing.assert_allclose(fresnel(inside, 1 / N)[0], reflected, rtol=1e-12)


def test_beyond_the_critical_angle_everything_is_reflected() -> None:
    critical = np.sqrt(1 - 1 / N**2)
    reflected, refracted = fresnel(np.array([0.99 * critical, 0.0]), 1 / N)
    np.testing.assert_array_equal(reflected, 1.0)
    np.testing.assert_array_equal(refracted, 0.0)


def test_equal_indices_reflect_nothing() -> None:
    np.testing.assert_allclose(fresnel(np.array([1.0, 0.3]), 1.0)[0], 0.0, atol=1e-12)


def test_a_smooth_face_refracts_by_snells_law() -> None:
    met = sample_rough_face(coming(0.6, 1), 1, 0.0, N, np.random.default_rng(0))
    assert met.refracted[0, 0] == pytest.approx(0.8 / N, rel=1e-5)
    assert met.reflected[0, 1] == pytest.approx(0.6, rel=1e-5)
    assert met.reflection[0] + met.transmission[0] == pytest.approx(1.0)


@pytest.mark.parametrize("eta", [N, 1 / N])
@pytest.mark.parametrize("cosine", [1.0, 0.7, 0.3])
def test_a_rough_face_keeps_almost_all_light(eta: float, cosine: float) -> None:
    met = sample_rough_face(coming(cosine), 1, 0.1, eta, np.random.default_rng(1))
    assert (met.reflection + met.transmission).mean() == pytest.approx(1.0, abs=0.015)
    np.testing.assert_allclose(np.linalg.norm(met.reflected, axis=1), 1.0, atol=1e-5)
    passed = met.transmission > 0
    np.testing.assert_allclose(np.linalg.norm(met.refracted[passed], axis=1), 1.0, atol=1e-5)


def test_shadowing_grows_towards_grazing_directions() -> None:
    values = shadowing(np.array([1.0, 0.1, 0.02]), 0.3)
    assert values[0] == 1.0
    assert (np.diff(values) < 0).all()
    np.testing.assert_array_equal(shadowing(np.array([0.01]), 0.0), 1.0)
