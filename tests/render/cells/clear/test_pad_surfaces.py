"""What rays meet on a pad is what Mitsuba says of its shapes and BSDFs."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from render.cells.clear.bond_optics import WindowBond, way_through_bond
from render.cells.clear.pad_surfaces import (
    BOND,
    BOND_MET,
    BOND_PASSED,
    DIELECTRIC,
    DIFFUSE,
    METAL,
    NO_TURN,
    PadSurfaces,
)
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


def test_light_passes_a_bond_by_snells_law_or_is_reflected_as_fresnel_says(
    mono: ModuleType,
) -> None:
    scene, count = scene_of_case("window of low index"), 1 << 15
    assert scene.window is not None
    surfaces = PadSurfaces(pad_scene(scene, 0.0, False), WindowBond(scene))
    rng = np.random.default_rng(2)
    for start, index, beyond in ((1.0, 1.41, 1.3), (-1.0, 1.3, 1.41)):
        # Steep enough to meet the bond before a wall.
        d = np.column_stack([rng.uniform(-2.5, 2.5, (count, 2)), np.full(count, -start)])
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        ray = mono.Vector3f(d.T.astype(np.float32))
        hit = surfaces.hit(mono.Point3f(0.0, 0.0, start) + 0.0 * ray, ray, mono.Bool(True))
        assert (np.array(hit.kind) == BOND).all()
        onward = surfaces.inside(hit, ray, mono.Float(rng.random(count).astype(np.float32)))
        through = np.array(onward.d, dtype=np.float64)[2] * -start > 0
        went = np.array(onward.d, dtype=np.float64).T
        np.testing.assert_allclose(went[through, :2] * beyond, d[through, :2] * index, atol=1e-6)
        np.testing.assert_allclose(went[~through], d[~through] * [1, 1, -1], atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(went, axis=1), 1.0, atol=1e-6)
        counted = np.array(onward.counts)
        assert set(counted[2][through]) == {BOND_PASSED}
        assert set(counted[2][~through]) == {BOND_MET}
        # On the side where it goes on.
        assert (np.sign(np.array(onward.p)[2]) == np.where(through, -start, start)).all()
        sine = np.linalg.norm(d[:, :2], axis=1)
        total = sine * index > beyond
        assert not through[total].any()
        assert total.any() == (index > beyond)
        chance = np.array(onward.chance)
        likely = np.where(through, chance, 1 - chance)
        error = np.sqrt(np.mean(likely * (1 - likely)) / count)
        assert abs(through.mean() - likely.mean()) < 4 * error


def test_skin_hides_what_is_behind_it_and_a_bond_does_not(mono: ModuleType) -> None:
    scene = scene_of_case("window")
    bond = WindowBond(scene)
    surfaces = PadSurfaces(pad_scene(scene, 0.0, True), bond)
    a = mono.Point3f([-7.0, -7.0], [-8.0, -8.0], [4.4, 4.4])
    # Over the lower face to untouched skin between the pyramids.
    across = mono.Vector3f([4.5, 9.5], [4.0, 13.0], [0.0, 0.0])
    way = way_through_bond(bond, across, a.z + 4.4, 2.0 * bond.thickness)
    length = way.pad_length + way.window_length
    passes = mono.UInt32(NO_TURN), mono.Bool(True)
    assert not np.array(surfaces.blocked(a, way.direction, length - 0.01, *passes)).any()
    # Behind it there is nothing to be seen.
    assert np.array(surfaces.blocked(a, way.direction, length + 2.0, *passes)).all()
    # Reflected by the bond light comes up to the skin on a shorter way.
    turns = mono.UInt32(0), mono.Bool(True)
    near = 2 * a.z / -way.direction.z
    assert not np.array(surfaces.blocked(a, way.direction, near - 0.01, *turns)).any()
    assert np.array(surfaces.blocked(a, way.direction, near + 1.0, *turns)).all()
    assert not np.array(surfaces.blocked(a, way.direction, near + 1.0, *passes)).any()
