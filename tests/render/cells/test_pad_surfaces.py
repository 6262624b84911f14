"""What rays meet on a pad is what Mitsuba says of its shapes and BSDFs."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from render.cells.pad_surfaces import DIELECTRIC, DIFFUSE, METAL, PadSurfaces
from render.optics.pad_scene import pad_scene
from tests.oracles.pads import scene_of_case


def test_kinds_normals_and_reflectances_are_those_of_mitsuba(mono: ModuleType) -> None:
    pad = pad_scene(scene_of_case("white, mirror and black walls"), 0.0, True)
    rng = np.random.default_rng(1)
    d = rng.normal(size=(3, 5000))
    d /= np.linalg.norm(d, axis=0)
    ray = mono.Ray3f(mono.Point3f(1.0, 2.0, 2.0), mono.Vector3f(d.astype(np.float32)))
    hit = PadSurfaces(pad).hit(ray.o, ray.d, mono.Bool(True))
    si = pad.ray_intersect(ray)
    flags = si.bsdf().flags()
    kind = np.array(hit.kind)
    assert np.array(hit.valid).all()
    np.testing.assert_allclose(np.array(hit.p), np.array(si.p), atol=1e-5)
    np.testing.assert_allclose(np.array(hit.n), np.array(si.n), atol=1e-4)
    for wanted, flag in (
        (DIFFUSE, mono.BSDFFlags.DiffuseReflection),
        (DIELECTRIC, mono.BSDFFlags.DeltaTransmission),
    ):
        np.testing.assert_array_equal(kind == wanted, np.array(mono.has_flag(flags, flag)))
    assert {DIFFUSE, DIELECTRIC, METAL} == set(kind.tolist())
    assert {0.0, 0.5, 1.0} < set(np.round(np.array(hit.reflectance), 4).tolist())
    metal = np.array(hit.reflectance)[kind == METAL]
    np.testing.assert_allclose(metal, 0.9, rtol=1e-5)
