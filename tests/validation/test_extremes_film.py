"""Materials and lights at the ends of their ranges, through ``bdpt`` and ``pssmlt``.

Demanded: finite pixels and an error bar that holds against an independent run of the other
integrator; a thing that cannot be rendered has a typed error that names the parameter.
"""

from __future__ import annotations

import time
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy import stats

from render.errors import RenderError
from tests.validation.film import LONG, camera, check_same, diffuse, gray, ours, relative_bar

SPP = 2048 if LONG else 128


def slab(
    mono: ModuleType,
    *,
    sigma_s: float = 4.0,
    sigma_a: float = 0.005,
    g: float = 0.75,
    alpha: float = 0.1,
    index: float = 1.41,
    sigma_v: float = 15.0,
    away: bool = False,
) -> Any:
    """Return a 2 mm layer on a coating, lit through its side by a fiber, seen from the front."""
    transform = mono.ScalarTransform4f()
    face: dict[str, Any] = {"type": "null"}
    if index > 1:
        face = {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}
        if alpha > 0:
            face |= {"type": "roughdielectric", "distribution": "beckmann", "alpha": alpha}
    sigma_t = sigma_s + sigma_a
    medium = {
        "type": "homogeneous", "sigma_t": sigma_t, "albedo": sigma_s / sigma_t if sigma_t else 0.0,
        "phase": {"type": "hg", "g": g},
    }  # fmt: skip
    return mono.load_dict(
        {
            "type": "scene",
            "layer": {
                "type": "cube", "to_world": transform.translate([0, 0, 1]).scale([2, 2, 1]),
                "bsdf": face, "interior": medium,
            },
            "coating": {
                "type": "rectangle",
                "to_world": transform.translate([0, 0, 2.1]).rotate([0, 1, 0], 180).scale(2),
                "bsdf": diffuse(mono, 0.6),
            },
            "fiber": {
                "type": "disk",
                "to_world": transform.translate([2.4, 0, 1]).rotate(
                    [0, 1, 0], 90 if away else -90
                ).scale(0.375),
                "bsdf": diffuse(mono, 0.0),
                "emitter": {"type": "fiber", "sigma_v": sigma_v, "power": 1.0},
            },
            "lamp": {"type": "point", "position": [-1, 1, -4], "intensity": gray(mono, 0.02)},
            "sensor": camera(mono, [0, 0, -6], fov=35),
        }
    )  # fmt: skip


ENDS: list[dict[str, Any]] = [
    {"sigma_s": 0.0}, {"sigma_s": 0.0, "sigma_a": 0.0}, {"sigma_s": 0.01}, {"sigma_s": 50.0},
    {"g": -0.9}, {"g": 0.0}, {"g": 0.99}, {"sigma_a": 0.0}, {"sigma_a": 10.0},
    {"alpha": 0.0}, {"alpha": 0.5}, {"index": 1.0}, {"index": 1.7},
    {"sigma_v": 0.1}, {"sigma_v": 89.0}, {"away": True},
    {"sigma_s": 50.0, "sigma_a": 0.0, "g": 0.0, "index": 1.7},
    {"sigma_s": 50.0, "g": -0.9, "alpha": 0.5}, {"g": 0.99, "alpha": 0.0, "sigma_v": 0.1},
]  # fmt: skip


@pytest.mark.parametrize("end", ENDS, ids=lambda end: ", ".join(f"{k} {v}" for k, v in end.items()))
def test_at_its_ends_a_parameter_gives_finite_pixels_and_an_error_bar_that_holds(
    mono: ModuleType, end: dict[str, Any]
) -> None:
    scene = slab(mono, **end)
    began = time.process_time()
    images = {"bdpt": ours(mono, scene, "bdpt", SPP)}
    if LONG:
        images["pssmlt"] = ours(mono, scene, "pssmlt", SPP)
    for kind, found in images.items():
        print(
            f"{end}, {kind}: {time.process_time() - began:.1f} s, mean {found.mean():.3g} "
            f"+- {relative_bar(found):.0%}"
        )
        assert np.isfinite(found).all()
        assert (found >= 0).all()
        assert found.mean() > 0
    if len(images) == 2:
        check_same(images["bdpt"], images["pssmlt"], str(end), size=4)


@pytest.mark.parametrize("value", [0.0, 0.05, 90.0, float("nan")])
def test_a_fiber_wider_or_narrower_than_the_profile_allows_is_named(
    mono: ModuleType, value: float
) -> None:
    with pytest.raises(Exception, match=r"sigma_v = .*allowed: 0\.1 to 89 deg"):
        slab(mono, sigma_v=value)


def test_a_lit_thing_outside_of_the_picture_leaves_it_exactly_black(mono: ModuleType) -> None:
    scene = mono.load_dict(
        {
            "type": "scene",
            "plane": {"type": "rectangle", "bsdf": diffuse(mono, 0.5)},
            "lamp": {"type": "point", "position": [0, 0, 1], "intensity": gray(mono, 1.0)},
            "sensor": camera(mono, [0, 0, 3], target=(0, 0, 9)),
        }
    )
    assert (ours(mono, scene, "bdpt", 256) == 0).all()
    with pytest.raises(RenderError, match="luminance_samples"):
        ours(mono, scene, "pssmlt", 256)


def test_the_bound_on_events_costs_less_than_a_picture_can_show(
    mono: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    from render.integrators import subpaths

    # The worst of the allowed layers: much scattering, none of it lost, light kept inside.
    scene = slab(mono, sigma_s=50.0, sigma_a=0.0, g=0.0, index=1.7)
    cut = {}
    for bound in (subpaths.EVENTS_MAX // 2, subpaths.EVENTS_MAX):
        monkeypatch.setattr(subpaths, "EVENTS_MAX", bound)
        began = time.process_time()
        cut[bound] = ours(mono, scene, "bdpt", SPP, seed=2), time.process_time() - began
    (short, quick), (full, slow) = cut.values()
    # Same seed, same paths: the difference is what the bound cuts off. (Between 500 events and the
    # bound 11 +- 9 % are found, in a picture that is itself off by 45 %: one bright sample.)
    lost = (full - short).mean(axis=(1, 2, 3)) / full.mean()
    bar = stats.sem(lost)
    print(
        f"events bounded by {list(cut)}: {lost.mean():.2e} +- {bar:.1e} of the light is lost "
        f"between, {quick:.1f} s and {slow:.1f} s"
    )
    assert abs(lost.mean()) < 0.02
