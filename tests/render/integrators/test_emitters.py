"""Emitters as starts of light subpaths: power, bounds, and what is told of others."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.errors import RenderError

COUNT = 1 << 16


def started(mono: ModuleType, scene: Any) -> tuple[Any, np.ndarray]:
    """Return light subpaths that start in a scene, and the power of each."""
    from render.integrators.emitters import Emission

    rng = np.random.default_rng(1)
    numbers = [mono.Float(rng.random(COUNT).astype(np.float32)) for _ in range(5)]
    ray = Emission(scene).start(numbers[0], mono.Point2f(*numbers[1:3]), *numbers[3:])
    return ray, np.array(ray.beta, dtype=np.float64)[0]


def plate(mono: ModuleType, **emitters: Any) -> Any:
    """Return a square of area 4 at z = 0, facing +z, with emitters."""
    return mono.load_dict({"type": "scene", "plate": {"type": "rectangle"}, **emitters})


def sky(mono: ModuleType) -> np.ndarray:
    return np.random.default_rng(2).random((8, 16, 3)).astype(np.float32)


@pytest.mark.parametrize("kind", ["constant", "envmap", "directional"])
def test_light_from_afar_brings_its_irradiance_onto_a_plate(mono: ModuleType, kind: str) -> None:
    direction = np.array([0.6, 0.0, -0.8])
    light: dict[str, Any] = {
        "constant": {"type": "constant", "radiance": 2.0},
        "envmap": {"type": "envmap", "bitmap": mono.Bitmap(sky(mono))},
        "directional": {
            "type": "directional", "direction": direction.tolist(), "irradiance": 3.0,
        },
    }[kind]  # fmt: skip
    scene = plate(mono, light=light)
    ray, power = started(mono, scene)
    assert np.array(ray.parallel).all()
    found = scene.ray_intersect(mono.Ray3f(ray.o, ray.d))
    hit = np.array(found.is_valid()) & (np.array(ray.d)[2] < 0)
    received = np.where(hit, power, 0.0)
    if kind == "envmap":
        rng = np.random.default_rng(3)
        up = mono.warp.square_to_cosine_hemisphere(
            mono.Point2f(rng.random((2, COUNT)).astype(np.float32))
        )
        si = dr.zeros(mono.SurfaceInteraction3f, COUNT)
        si.wi = -up
        truth = 4 * np.pi * np.array(scene.environment().eval(si))[0].mean()
    else:
        truth = 4 * {"constant": 2.0 * np.pi, "directional": 3.0 * 0.8}[kind]
    assert abs(received.mean() - truth) < 4 * received.std() / np.sqrt(COUNT) + 0.005 * truth


def test_a_spot_sends_all_of_its_power_into_its_cone(mono: ModuleType) -> None:
    transform = mono.ScalarTransform4f()
    spot = {
        "type": "spot", "cutoff_angle": 30.0, "beam_width": 10.0, "intensity": 2.0,
        "to_world": transform.look_at(origin=[0, 0, 3], target=[0, 1, 0], up=[1, 0, 0]),
    }  # fmt: skip
    ray, power = started(mono, plate(mono, light=spot))
    axis = np.array([0, 1, -3]) / np.sqrt(10)
    assert (np.array(ray.d).T @ axis >= np.cos(np.radians(30)) - 1e-5).all()
    angle = np.linspace(0, np.radians(30), 4001)
    beam = 2.0 * np.clip((np.radians(30) - angle) / np.radians(20), 0, 1)
    truth = 2 * np.pi * np.trapezoid(beam * np.sin(angle), angle)
    assert power.mean() == pytest.approx(truth, rel=0.01)


def test_the_rays_of_a_measured_light_carry_its_power(mono: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "led.csv"
    path.write_text("0,1\n20,3\n60,0.5\n90,0.2\n")
    light = {"type": "measured_light", "filename": str(path), "power": 2.5}
    scene = mono.load_dict({"type": "scene", "lamp": {"type": "disk", "emitter": light}})
    _, power = started(mono, scene)
    assert power.mean() == pytest.approx(2.5, rel=2e-3)
    rng = np.random.default_rng(4)
    numbers = [mono.Float(rng.random(COUNT).astype(np.float32)) for _ in range(5)]
    _, weight = scene.emitters()[0].sample_ray(
        mono.Float(0.0), numbers[0], mono.Point2f(*numbers[1:3]), mono.Point2f(*numbers[3:])
    )
    assert np.array(weight)[0].mean() == pytest.approx(2.5, rel=2e-3)


def test_the_sphere_around_a_scene_holds_meshes_that_the_loader_has_merged(
    mono: ModuleType,
) -> None:
    from render.integrators.emitters import bounding_sphere

    transform = mono.ScalarTransform4f()
    walls = {
        f"wall{z}": {"type": "rectangle", "to_world": transform.translate([0, 0, z]).scale(3)}
        for z in (-2, 4)
    }
    center, radius = bounding_sphere(mono.load_dict({"type": "scene", **walls}))
    np.testing.assert_allclose(center, [0, 0, 1])
    assert radius == pytest.approx(np.sqrt(27))


def test_a_file_is_asked_for_where_a_measured_light_has_none(mono: ModuleType) -> None:
    with pytest.raises(RenderError, match=r"^lamp\.emitter: measured_light needs a file") as caught:
        plate(mono, lamp={"type": "disk", "emitter": {"type": "measured_light"}})
    assert "\n" not in str(caught.value)
    xml = '<scene version="3.0.0"><emitter type="measured_light"/></scene>'
    with pytest.raises(RenderError, match=r"^measured_light needs a filename"):
        mono.load_string(xml)
    with pytest.raises(RuntimeError, match="nonesuch"):
        plate(mono, lamp={"type": "nonesuch"})


def test_a_measured_light_that_no_shape_has_leaves_other_scenes_alone(
    mono: ModuleType, tmp_path: Path
) -> None:
    from render.integrators.emitters import Emission

    path = tmp_path / "led.csv"
    path.write_text("0,1\n60,0.5\n90,0\n")
    light = {"type": "measured_light", "filename": str(path)}
    forgotten = plate(mono, lamp=light)
    with pytest.raises(RenderError, match="those of surfaces go into their shapes"):
        Emission(forgotten)
    lit = plate(mono, lamp={"type": "disk", "emitter": light})
    ray, power = started(mono, lit)
    assert np.isfinite(np.array(ray.o)).all()
    assert power.mean() == pytest.approx(1.0, rel=0.02)
    del forgotten


def test_emitters_that_are_off_are_named(mono: ModuleType) -> None:
    from render.integrators.emitters import Emission

    off = {"type": "constant", "radiance": 0.0}
    with pytest.raises(RenderError, match=r"\('gloom'\) emits nothing") as caught:
        Emission(plate(mono, gloom=off)).refuse_dark()
    assert caught.value.field == "emitter"
