"""Transmittances of weights: exact in a box, cut where it is dark, 1 where there is no medium."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.integrators.medium_boxes import MediumBoxes
from render.paths.connect import optical_depth, trace_to_surface
from render.paths.vertex import empty_vertex
from tests.validation.test_slab_reference import lamp, slab

SIGMA = 2.005
COUNT = 1 << 12


@pytest.fixture(scope="module")
def scene(mono: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the slab whose layer 8 < x < 10 scatters."""
    return slab(mono, tmp_path_factory.mktemp("slab"), lamp(mono))


def layer(mono: ModuleType, scene: Any) -> Any:
    (medium,) = {s.interior_medium() for s in scene.shapes() if s.interior_medium() is not None}
    return mono.MediumPtr(medium)


def vertices(mono: ModuleType, medium: Any) -> Any:
    """Return vertices in the layer."""
    v = empty_vertex()
    places = np.random.default_rng(1).random((3, COUNT))
    places = np.array([8.0, -12.0, 0.0])[:, None] + np.array([2.0, 24.0, 4.0])[:, None] * places
    v.p, v.medium = mono.Point3f(places.astype(np.float32)), medium
    v.volume, v.weight = mono.Bool(True), mono.Float(1.0)
    return v


def test_in_a_layer_it_is_what_a_ray_to_the_end_of_the_layer_says(
    mono: ModuleType, scene: Any
) -> None:
    v = vertices(mono, layer(mono, scene))
    w = np.random.default_rng(2).standard_normal((3, COUNT))
    direction = mono.Vector3f((w / np.linalg.norm(w, axis=0)).astype(np.float32))
    boxes = MediumBoxes(scene, scene.sensors()[0])
    assert not boxes.others
    found = np.array(boxes.transmittance(v, v.p + 100.0 * direction, mono.Bool(True)))
    # The optical depth to the next face that is no null boundary: behind the layer all is clear.
    _, depth, _ = trace_to_surface(scene, v, direction, dr.full(mono.Bool, True, COUNT))
    expected = np.exp(-np.minimum(np.array(depth[0]), 4.0))
    assert (expected > np.exp(-3.99)).mean() > 0.5
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_without_null_boundaries_one_ray_says_what_is_in_the_way(mono: ModuleType) -> None:
    from render.integrators.emitters import Emission
    from tests.render.integrators.test_mirror_connections import lit

    scene = lit(mono, {"sigma_t": 1.0, "albedo": 0.9, "phase": {"type": "hg", "g": 0.5}})
    assert not Emission(scene).nulls
    inside = next(s.interior_medium() for s in scene.shapes() if s.interior_medium() is not None)
    ends = []
    for seed in range(2):
        v = vertices(mono, mono.MediumPtr(inside))
        places = np.random.default_rng(seed).random((3, COUNT)) * 3.0 - 1.5
        v.p = mono.Point3f(places.astype(np.float32))
        ends.append(v)
    active = dr.full(mono.Bool, True, COUNT)
    by_steps, by_one = (optical_depth(scene, *ends, active, nulls) for nulls in (True, False))
    clear = np.array(by_steps[1])
    np.testing.assert_array_equal(clear, np.array(by_one[1]))
    assert 0.1 < clear.mean() < 0.9
    depths = [np.array(depth[0])[clear] for depth, _ in (by_steps, by_one)]
    np.testing.assert_allclose(*depths, rtol=1e-6)


def test_it_ends_at_a_point_that_is_nearer_and_is_never_0(mono: ModuleType, scene: Any) -> None:
    v = vertices(mono, layer(mono, scene))
    v.p = mono.Point3f(9.0, 0.0, 2.0)
    boxes = MediumBoxes(scene, scene.sensors()[0])
    near = boxes.transmittance(v, mono.Point3f(9.0, 0.25, 2.0), mono.Bool(True))
    assert near[0] == pytest.approx(np.exp(-0.25 * SIGMA), rel=1e-4)
    far = boxes.transmittance(v, mono.Point3f(9.0, 10.0, 2.0), mono.Bool(True))
    assert far[0] == pytest.approx(np.exp(-4.0), rel=1e-4)


def test_without_a_medium_it_is_1(mono: ModuleType, scene: Any) -> None:
    v = vertices(mono, dr.zeros(mono.MediumPtr))
    boxes = MediumBoxes(scene, scene.sensors()[0])
    found = boxes.transmittance(v, mono.Point3f(0.0, 0.0, 2.0), mono.Bool(True))
    assert (np.array(found) == 1.0).all()


def milky_ball(mono: ModuleType, **sensor: Any) -> Any:
    """Return a ball of radius 1, whose medium fills half of its box."""
    milk = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.5}
    bsdf = {"type": "roughdielectric"}
    ball = {"type": "sphere", "radius": 1.0, "bsdf": bsdf, "interior": milk}
    return mono.load_dict(
        {"type": "scene", "ball": ball, "sensor": {"type": "perspective", **sensor}}
    )


def test_a_medium_that_does_not_fill_its_box_ends_where_a_ray_says(mono: ModuleType) -> None:
    scene = milky_ball(mono)
    boxes = MediumBoxes(scene, scene.sensors()[0])
    assert boxes.others
    assert boxes.media == []
    v = vertices(mono, layer(mono, scene))
    v.p = mono.Point3f(0.0, 0.0, 0.5)
    beyond = mono.Point3f(2.0, 2.0, 0.5)
    found = boxes.transmittance(v, beyond, mono.Bool(True))
    assert found[0] == pytest.approx(np.exp(-0.5 * np.sqrt(0.75)), rel=1e-4)


def test_the_medium_that_the_camera_is_in_has_no_end(mono: ModuleType) -> None:
    scene = milky_ball(mono, fog={"type": "homogeneous", "sigma_t": 0.1, "albedo": 0.5})
    sensor = scene.sensors()[0]
    v = vertices(mono, mono.MediumPtr(sensor.get_medium()))
    v.p = mono.Point3f(5.0, 0.0, 0.0)
    boxes = MediumBoxes(scene, sensor)
    found = boxes.transmittance(v, mono.Point3f(5.0, 0.0, 20.0), mono.Bool(True))
    assert found[0] == pytest.approx(np.exp(-2.0), rel=1e-4)


def test_a_medium_in_a_group_of_shapes_is_one_of_the_scene(mono: ModuleType) -> None:
    from render.integrators.emitters import Emission

    fog = {"type": "homogeneous", "sigma_t": 1.0}
    ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": fog}
    grouped = {
        "group": {"type": "shapegroup", "ball": ball},
        "there": {"type": "instance", "ref": {"type": "ref", "id": "group"}},
    }
    light = {"light": {"type": "point"}}
    assert Emission(mono.load_dict({"type": "scene"} | light | grouped)).media
    assert not Emission(mono.load_dict({"type": "scene"} | light)).media
