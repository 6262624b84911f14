"""Glimpses of light vertices: rough, but positive, finite, and right about distance."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.integrators.camera_subpaths import Kept
from render.integrators.light_subpaths import LightVertex
from render.integrators.proxy_weights import Look, Seen, glimpse

COUNT = 1 << 12


def points(mono: ModuleType, seed: int, scale: float) -> Any:
    rng = np.random.default_rng(seed)
    return mono.Point3f((scale * rng.standard_normal((3, COUNT))).astype(np.float32))


def directions(mono: ModuleType, seed: int) -> Any:
    rng = np.random.default_rng(seed)
    w = rng.standard_normal((3, COUNT))
    return mono.Vector3f((w / np.linalg.norm(w, axis=0)).astype(np.float32))


def seen(mono: ModuleType, p: Any, **fields: Any) -> Seen:
    record = LightVertex.empty()
    record.vertex.p, record.vertex.wi = p, directions(mono, 3)
    record.vertex.beta = mono.Spectrum(2.0)
    for name, value in fields.items():
        setattr(record.vertex, name, value)
    return Seen.of(record, mono.Float(1.0))


def look(mono: ModuleType, p: Any, **fields: Any) -> Look:
    end = Kept.empty()
    end.vertex.p, end.vertex.wi, end.vertex.weight = p, directions(mono, 4), mono.Float(1.0)
    for name, value in fields.items():
        setattr(end.vertex, name, value)
    return Look.of(end)


@pytest.mark.parametrize("kind", ["volume", "diffuse", "glossy"])
@pytest.mark.parametrize("scale", [0.0, 1e-3, 1.0, 1e4])
def test_a_glimpse_is_positive_and_finite_wherever_the_vertices_are(
    mono: ModuleType, kind: str, scale: float
) -> None:
    fields = {} if kind == "glossy" else {kind: mono.Bool(True)}
    largest = mono.Float(1e30)
    sums = {"vcm": largest, "vc": largest} if kind == "volume" else {}
    y = seen(mono, points(mono, 1, scale), **fields, **sums)
    found = np.array(glimpse(y, look(mono, points(mono, 2, scale), **fields, **sums)))
    assert np.isfinite(found).all()
    assert (found > 0).all()


def test_power_and_the_square_of_the_distance_count_between_surfaces(mono: ModuleType) -> None:
    a, y = points(mono, 1, 1.0), points(mono, 2, 1.0)
    diffuse = {"diffuse": mono.Bool(True)}
    near = np.array(glimpse(seen(mono, y, **diffuse), look(mono, a, **diffuse)))
    far = np.array(glimpse(seen(mono, a + 3.0 * (y - a), **diffuse), look(mono, a, **diffuse)))
    np.testing.assert_allclose(near, 9.0 * far, rtol=1e-3)
    bright = seen(mono, y, **diffuse, beta=mono.Spectrum(6.0))
    np.testing.assert_allclose(
        np.array(glimpse(bright, look(mono, a, **diffuse))), 3.0 * near, rtol=1e-5
    )


def test_nothing_is_seen_of_a_light_subpath_that_left_no_vertex(mono: ModuleType) -> None:
    record = LightVertex.empty()
    record.vertex.beta = dr.full(mono.Spectrum, 2.0, COUNT)
    y = Seen.of(record, mono.Float(0.0))
    found = np.array(glimpse(y, look(mono, points(mono, 2, 1.0))))
    assert (found == 0).all()
