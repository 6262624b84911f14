"""Proxy weights are positive wherever light can be, and know where glossy vertices scatter."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.integrators.resampling import (
    CameraProxy,
    LightProxies,
    glossy_lobes,
    mirrored_proxy_weight,
    proxy_weight,
)
from render.integrators.subpaths import SubpathVertex
from render.paths.vertex import scattering_value

COUNT = 1 << 12


def points(mono: ModuleType, seed: int, scale: float) -> Any:
    rng = np.random.default_rng(seed)
    return mono.Point3f((scale * rng.standard_normal((3, COUNT))).astype(np.float32))


def directions(mono: ModuleType, seed: int) -> Any:
    rng = np.random.default_rng(seed)
    w = rng.standard_normal((3, COUNT))
    return mono.Vector3f((w / np.linalg.norm(w, axis=0)).astype(np.float32))


def light(mono: ModuleType, p: Any, **fields: Any) -> LightProxies:
    record = SubpathVertex.none()
    record.vertex.p, record.vertex.wi = p, directions(mono, 3)
    record.vertex.beta = mono.Spectrum(2.0)
    for name, value in fields.items():
        setattr(record.vertex, name, value)
    return LightProxies.of(record, mono.Float(1.0))


def camera(mono: ModuleType, p: Any, **fields: Any) -> CameraProxy:
    kept = SubpathVertex.none()
    kept.vertex.p, kept.vertex.wi, kept.vertex.weight = p, directions(mono, 4), mono.Float(1.0)
    for name, value in fields.items():
        setattr(kept.vertex, name, value)
    return CameraProxy.of(kept)


@pytest.mark.parametrize("kind", ["volume", "diffuse", "glossy"])
@pytest.mark.parametrize("scale", [0.0, 1e-3, 1.0, 1e4])
def test_a_proxy_weight_is_positive_and_finite_wherever_the_vertices_are(
    mono: ModuleType, kind: str, scale: float
) -> None:
    fields = {} if kind == "glossy" else {kind: mono.Bool(True)}
    largest = mono.Float(1e30)
    sums = {"d_vcm": largest, "d_vc": largest} if kind == "volume" else {}
    y = light(mono, points(mono, 1, scale), **fields, **sums)
    found = np.array(proxy_weight(y, camera(mono, points(mono, 2, scale), **fields, **sums)))
    assert np.isfinite(found).all()
    assert (found > 0).all()


def test_power_and_the_square_of_the_distance_count_between_surfaces(mono: ModuleType) -> None:
    a, y = points(mono, 1, 1.0), points(mono, 2, 1.0)
    diffuse = {"diffuse": mono.Bool(True)}
    near = np.array(proxy_weight(light(mono, y, **diffuse), camera(mono, a, **diffuse)))
    far = np.array(
        proxy_weight(light(mono, a + 3.0 * (y - a), **diffuse), camera(mono, a, **diffuse))
    )
    np.testing.assert_allclose(near, 9.0 * far, rtol=1e-3)
    bright = light(mono, y, **diffuse, beta=mono.Spectrum(6.0))
    np.testing.assert_allclose(
        np.array(proxy_weight(bright, camera(mono, a, **diffuse))), 3.0 * near, rtol=1e-5
    )


def test_nothing_is_seen_of_a_light_subpath_that_left_no_vertex(mono: ModuleType) -> None:
    record = SubpathVertex.none()
    record.vertex.beta = dr.full(mono.Spectrum, 2.0, COUNT)
    y = LightProxies.of(record, mono.Float(0.0))
    found = np.array(proxy_weight(y, camera(mono, points(mono, 2, 1.0))))
    assert (found == 0).all()


@pytest.mark.parametrize("scale", [0.0, 1e-3, 1.0, 1e4])
def test_a_proxy_weight_over_mirrors_is_positive_and_finite_wherever_the_vertices_are(
    mono: ModuleType, scale: float
) -> None:
    y = light(mono, points(mono, 1, scale), volume=mono.Bool(True))
    a, image = points(mono, 2, scale), points(mono, 5, scale)
    found = np.array(mirrored_proxy_weight(y, a, image, mono.Float(0.01)))
    assert np.isfinite(found).all()
    assert (found > 0).all()


def test_light_that_goes_on_towards_the_mirror_image_counts_most(mono: ModuleType) -> None:
    # Light that flies up to the origin, below a mirror: the image of the end is above it.
    record = SubpathVertex.none()
    record.vertex.p, record.vertex.wi = mono.Point3f(0.0), mono.Vector3f(0, 0, -1)
    record.vertex.beta, record.vertex.volume = mono.Spectrum(2.0), mono.Bool(True)
    y = LightProxies.of(record, mono.Float(1.0))
    a, blur = mono.Point3f(0.0, 0.0, -1.0), mono.Float(0.0)
    ahead = mirrored_proxy_weight(y, a, mono.Point3f(0.0, 0.0, 3.0), blur)[0]
    aside = mirrored_proxy_weight(y, a, mono.Point3f(3.0, 0.0, 0.0), blur)[0]
    assert ahead == pytest.approx(2.0 * (1.05 / 9.0 + 0.05), rel=1e-4)
    assert aside == pytest.approx(2.0 * ((0.05 + 1.0 / 16.0) / 9.0 + 0.05), rel=1e-4)


ROUGHNESS, INDEX = 0.05, 1.41


def rough_glass(mono: ModuleType, from_outside: bool, cosine: float) -> tuple[Any, dict[str, Any]]:
    """Return a rough boundary in the plane z = 0, and fields of a vertex there.

    Light arrives with that ``cosine``, in the plane y = 0 and towards +x.
    """
    bsdf = mono.load_dict(
        {"type": "roughdielectric", "alpha": ROUGHNESS, "int_ior": INDEX, "ext_ior": 1.0}
    )
    sine = float(np.sqrt(1 - cosine**2))
    wi = mono.Vector3f(-sine, 0.0, cosine if from_outside else -cosine)
    frame = mono.Frame3f(mono.Vector3f(1, 0, 0), mono.Vector3f(0, 1, 0), mono.Vector3f(0, 0, 1))
    up = mono.Normal3f(0, 0, 1)
    return bsdf, {"bsdf": mono.BSDFPtr(bsdf), "wi": wi, "frame": frame, "n": up}


@pytest.mark.parametrize("cosine", [0.9, 0.6])
@pytest.mark.parametrize("from_outside", [True, False])
def test_proxy_weights_know_where_a_rough_boundary_reflects_and_refracts(
    mono: ModuleType, from_outside: bool, cosine: float
) -> None:
    _, fields = rough_glass(mono, from_outside, cosine)
    record = SubpathVertex.none()
    for name, value in fields.items():
        setattr(record.vertex, name, value)
    record.vertex.beta = mono.Spectrum(2.0)
    sine = np.sqrt(1 - cosine**2)
    sine_beyond = sine / INDEX if from_outside else sine * INDEX
    side = 1.0 if from_outside else -1.0
    mode = mono.TransportMode.Importance
    (reflected, light), (refracted, beyond) = glossy_lobes(record.vertex, mode, mono.Bool(True))
    np.testing.assert_allclose(np.array(reflected)[:, 0], [sine, 0, side * cosine], atol=1e-5)
    if sine_beyond < 1:  # else everything is reflected
        expected = [sine_beyond, 0, -side * np.sqrt(1 - sine_beyond**2)]
        np.testing.assert_allclose(np.array(refracted)[:, 0], expected, atol=1e-5)
    else:
        assert beyond[0] <= light[0]
    # No direction is much brighter than the brighter one of the two.
    everywhere = np.pi * np.array(
        scattering_value(record.vertex, directions(mono, 5), mode, mono.Bool(True))
    )
    assert everywhere.max() < 1.2 * max(light[0], beyond[0])
    # What is sent in that direction is drawn rather than what is sent elsewhere.
    y, along = LightProxies.of(record, mono.Float(1.0)), reflected
    if beyond[0] > light[0]:
        along = refracted
    diffuse = {"diffuse": mono.Bool(True)}
    there = proxy_weight(y, camera(mono, mono.Point3f(3.0 * along), **diffuse))
    elsewhere = proxy_weight(y, camera(mono, mono.Point3f(3.0 * directions(mono, 6)), **diffuse))
    assert np.median(np.array(there)) > 10 * np.median(np.array(elsewhere))
