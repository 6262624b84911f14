"""The ``fiber`` emitter by itself and under three integrators."""

from __future__ import annotations

import subprocess
import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from render.errors import RenderError
from render.optics.fiber_profile import peak_radiance

WIDTH = 8


def lamp(mono: ModuleType, **parameters: float) -> dict[str, Any]:
    to_world = mono.ScalarTransform4f().translate([0, 0, 1.5]).rotate([1, 0, 0], 180).scale(0.375)
    return {"type": "disk", "to_world": to_world, "emitter": {"type": "fiber", **parameters}}


def lit_floor(mono: ModuleType) -> Any:
    transform = mono.ScalarTransform4f()
    return mono.load_dict(
        {
            "type": "scene",
            "lamp": lamp(mono, sigma_v=20.0, power=10.0),
            "floor": {
                "type": "rectangle",
                "to_world": transform.scale(4),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.8}},
            },
            "wall": {
                "type": "rectangle",
                "to_world": transform.translate([0, 2, 1]).rotate([1, 0, 0], 90).scale(2),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.5}},
            },
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": transform.look_at(origin=[0, -4, 3], target=[0, 0, 0], up=[0, 0, 1]),
                "film": {
                    "type": "hdrfilm", "width": WIDTH, "height": WIDTH,
                    "rfilter": {"type": "box"}, "pixel_format": "luminance",
                },
            },
        }
    )  # fmt: skip


@pytest.mark.parametrize("sigma_v", [0.1, 15.0, 89.0])
def test_the_rays_of_an_emitter_carry_its_power(mono: ModuleType, sigma_v: float) -> None:
    scene = mono.load_dict({"type": "scene", "lamp": lamp(mono, sigma_v=sigma_v, power=2.5)})
    count = 1 << 16
    rng = np.random.default_rng(1)
    numbers = [mono.Float(rng.random(count).astype(np.float32)) for _ in range(5)]
    ray, weight = scene.emitters()[0].sample_ray(
        mono.Float(0.0), numbers[0], mono.Point2f(*numbers[1:3]), mono.Point2f(*numbers[3:])
    )
    power = np.array(weight, dtype=np.float64)
    assert abs(power.mean() - 2.5) < 4 * power.std() / np.sqrt(count) + 1e-4
    assert (np.array(ray.d)[2] < 0).all()


def test_the_unit_power_is_the_default(mono: ModuleType) -> None:
    scene = mono.load_dict({"type": "scene", "lamp": lamp(mono, sigma_v=15.0)})
    area = np.pi * 0.375**2
    peak = scene.emitters()[0].peak
    assert peak == pytest.approx(peak_radiance(np.radians(15.0), area), rel=1e-4)


def test_radiance_on_the_axis_may_be_given_instead(mono: ModuleType) -> None:
    scene = mono.load_dict({"type": "scene", "lamp": lamp(mono, radiance=7.0)})
    assert scene.emitters()[0].peak == 7.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("sigma_v", 0.0),
        ("sigma_v", 90.0),
        ("sigma_v", float("nan")),
        ("power", -1.0),
        ("power", float("inf")),
        ("radiance", -1.0),
    ],
)
def test_a_parameter_out_of_range_is_named_with_what_is_allowed(
    mono: ModuleType, name: str, value: float
) -> None:
    with pytest.raises(RenderError, match=f"^lamp.*{name} = .*allowed"):
        mono.load_dict({"type": "scene", "lamp": lamp(mono, **{name: value})})


@pytest.mark.slow
def test_path_bdpt_and_pssmlt_agree_on_what_the_emitter_lights(mono: ModuleType) -> None:
    scene = lit_floor(mono)
    path = mono.load_dict({"type": "path"})
    runs = np.stack(
        [np.array(mono.render(scene, integrator=path, spp=256, seed=s)) for s in range(8)]
    )
    truth, error = runs.mean(axis=0), runs.std(axis=0, ddof=1) / np.sqrt(8)
    assert truth.mean() > 0
    for kind in ("bdpt", "pssmlt"):
        alone = {"chains": 4096, "luminance_samples": 32768, "chains_only": True}
        chains = alone if kind == "pssmlt" else {}
        integrator = mono.load_dict({"type": kind, "error_bars": True, **chains})
        image = np.array(mono.render(scene, integrator=integrator, spp=512))
        score = (image[..., :1] - truth) / np.hypot(image[..., 1:], error)
        assert np.abs(score).max() < 6
        assert (np.abs(score) < 2.5).mean() > 0.85
        assert image[..., 0].mean() == pytest.approx(truth.mean(), rel=0.02)


RGB = """
import numpy as np
from render.reference.llvm import mitsuba
mi = mitsuba("llvm_ad_rgb")
T = mi.ScalarTransform4f()
scene = mi.load_dict({
    "type": "scene",
    "lamp": {"type": "disk", "to_world": T.translate([0, 0, 1.5]).rotate([1, 0, 0], 180),
             "emitter": {"type": "fiber", "sigma_v": 40.0, "power": 10.0}},
    "floor": {"type": "rectangle", "to_world": T.scale(4), "bsdf": {
        "type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.4, 0.2]}}},
    "sensor": {"type": "perspective", "fov": 40,
               "to_world": T.look_at(origin=[0, -4, 3], target=[0, 0, 0], up=[0, 0, 1]),
               "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}},
})
image = np.array(mi.render(scene, integrator=mi.load_dict({"type": "bdpt"}), spp=4096))
r, g, b = image.mean((0, 1))
print(r / g, b / g)
assert abs(r / g - 2) < 1e-3 and abs(b / g - 0.5) < 1e-3
"""


@pytest.mark.slow
def test_the_emitter_is_gray_in_the_rgb_variant() -> None:
    done = subprocess.run(
        [sys.executable, "-c", RGB], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
