"""The skin's BSDF with a lobe: against its formula, and it keeps its light."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from render.optics.pad_scene import coated
from render.scene import Coating

ANGLES = (0.0, 30.0, 60.0, 80.0)


def coating(albedo: float, specular: float | None, roughness: float | None) -> Coating:
    return Coating.model_construct(albedo=albedo, specular=specular, roughness=roughness)


def unit(polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    sine = np.sin(polar)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)], axis=-1)


def directions(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a grid of directions over the hemisphere ``(direction, 3)`` and solid angles."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    azimuth = 2 * np.pi * (np.arange(2 * count) + 0.5) / (2 * count)
    cosine, turned = np.meshgrid((nodes + 1) / 2, azimuth, indexing="ij")
    solid = np.repeat(weights / 2, 2 * count) * np.pi / count
    return unit(np.arccos(cosine).ravel(), turned.ravel()), solid


def value(
    d: np.ndarray, view: np.ndarray, albedo: float, specular: float, alpha: float
) -> np.ndarray:
    """Return f cos(d): Walter et al. 2007, eqs. 20 (without Fresnel), 25 and 27."""
    half = d + view
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    tangent = (1 - half[..., 2] ** 2) / half[..., 2] ** 2
    density = np.exp(-tangent / alpha**2) / (np.pi * alpha**2 * half[..., 2] ** 4)
    kept = np.ones(())
    for each in (d, view):
        tangent = np.sqrt(np.maximum(1 - each[..., 2] ** 2, 0.0)) / each[..., 2]
        a = 1 / np.maximum(alpha * tangent, 0.1)  # beyond 1.6 nothing is masked
        ratio = (3.535 * a + 2.181 * a**2) / (1 + 2.276 * a + 2.577 * a**2)
        kept = kept * np.where(a < 1.6, ratio, 1.0)
    return d[..., 2] * (albedo / np.pi + specular * density * kept / (4 * d[..., 2] * view[..., 2]))


def asked(mi: ModuleType, bsdf: Any, view: np.ndarray, wo: np.ndarray) -> tuple[Any, Any]:
    """Return value and density of light from ``wo`` ``(direction, 3)`` seen from ``view``."""
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, len(wo))
    si.wi = mi.Vector3f(*np.broadcast_to(view, wo.shape).T.astype(np.float32))
    found = bsdf.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(*wo.T.astype(np.float32)))
    return np.array(found[0])[0], np.array(found[1])


@pytest.mark.parametrize(("share", "alpha"), [(0.1, 0.5), (0.4, 0.1), (0.55, 0.3)])
def test_it_has_the_values_of_its_formula(mono: ModuleType, share: float, alpha: float) -> None:
    bsdf = mono.load_dict(coated(coating(0.45, share, alpha)))
    wo, _ = directions(24)
    for angle in ANGLES:
        view = unit(np.radians(angle), np.zeros(()))
        expected = value(wo, view, 0.45, share, alpha)
        np.testing.assert_allclose(asked(mono, bsdf, view, wo)[0], expected, rtol=2e-3, atol=1e-5)


def test_light_takes_the_same_part_both_ways(mono: ModuleType) -> None:
    bsdf = mono.load_dict(coated(coating(0.3, 0.5, 0.2)))
    rng = np.random.default_rng(1)
    one, other = (unit(np.arccos(rng.random(500)), 7 * rng.random(500)) for _ in range(2))
    there = asked(mono, bsdf, one, other)[0] / other[:, 2]
    back = asked(mono, bsdf, other, one)[0] / one[:, 2]
    np.testing.assert_allclose(there, back, rtol=1e-3)


@pytest.mark.parametrize("alpha", [0.05, 0.1, 0.3, 0.5])
def test_it_sends_back_what_is_named_but_for_what_microfacets_mask(
    mono: ModuleType, alpha: float
) -> None:
    bsdf = mono.load_dict(coated(coating(0.3, 0.6, alpha)))
    wo, solid = directions(192)
    for angle in ANGLES:
        seen, density = asked(mono, bsdf, unit(np.radians(angle), np.zeros(())), wo)
        sent = float(seen @ solid)
        assert sent < 0.9 + 1e-3
        # Less than a tenth of the lobe up to 60 deg at the roughest; none of it head-on to 0.3.
        assert sent > (0.9 - 0.6 * (0.14 if angle <= 60 else 0.2))
        if angle == 0.0 and alpha <= 0.3:
            assert sent == pytest.approx(0.9, abs=2e-3)
        assert float(density @ solid) < 1.0 + 1e-3


def test_directions_are_drawn_with_the_density_that_is_told(mono: ModuleType) -> None:
    import drjit as dr

    bsdf = mono.load_dict(coated(coating(0.3, 0.6, 0.2)))
    count, rng = 400_000, np.random.default_rng(3)
    numbers = rng.random((3, count)).astype(np.float32)
    si = dr.zeros(mono.SurfaceInteraction3f, count)
    view = unit(np.radians(50.0), np.zeros(()))
    si.wi = mono.Vector3f(*view.tolist())
    context = mono.BSDFContext()
    sample, weight = bsdf.sample(
        context, si, mono.Float(numbers[0]), mono.Point2f(numbers[1], numbers[2])
    )
    drawn, told = np.array(sample.wo).T, np.array(sample.pdf)
    kept = drawn[:, 2] > 0
    assert (np.array(weight)[0][~kept] == 0).all()
    again = np.array(bsdf.pdf(context, si, sample.wo))
    # One density for both parts, as the balance heuristic needs it.
    np.testing.assert_allclose(told[kept], again[kept], rtol=1e-3)
    expected = value(drawn[kept].astype(np.float64), view, 0.3, 0.6, 0.2) / told[kept]
    np.testing.assert_allclose(np.array(weight)[0][kept], expected, rtol=5e-3, atol=1e-4)
    # Shares of a few regions of the hemisphere, against the density's integral.
    wo, solid = directions(256)
    density = asked(mono, bsdf, view, wo)[1] * solid
    for low, high in ((0.0, 0.4), (0.4, 0.7), (0.7, 1.0)):
        for side in (-1.0, 1.0):

            def within(
                d: np.ndarray, low: float = low, high: float = high, side: float = side
            ) -> Any:
                return (d[:, 2] >= low) & (d[:, 2] < high) & (side * d[:, 0] > 0)

            part = within(drawn)[kept].sum() / count
            error = np.sqrt(part / count)
            assert part == pytest.approx(density[within(wo)].sum(), abs=4 * error + 2e-3)


def test_without_a_lobe_it_is_lambertian(mono: ModuleType) -> None:
    plain = coated(coating(0.45, None, None))
    assert plain == coated(coating(0.45, 0.0, 0.3))
    assert plain["type"] == "diffuse"
