"""Flat glossy faces are found in any scene, with the roughness that they were given."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from render.integrators.planar_mirrors import (
    COSINE_BINS,
    MIRRORS_MAX,
    REFLECTANCE_MIN,
    find_mirrors,
    measured_reflectance,
    measured_slope,
)

ROUGH = {"type": "roughdielectric", "distribution": "beckmann", "alpha": 0.2, "int_ior": 1.4}


def scene(mono: ModuleType, **shapes: Any) -> Any:
    return mono.load_dict({"type": "scene", **shapes})


def test_a_rough_cube_has_its_six_faces(mono: ModuleType) -> None:
    to_world = mono.ScalarTransform4f().translate([1, 2, 3]).rotate([0, 1, 0], 30).scale([1, 2, 3])
    found = find_mirrors(scene(mono, cube={"type": "cube", "bsdf": ROUGH, "to_world": to_world}))
    assert [m.area for m in found] == pytest.approx([24, 24, 12, 12, 8, 8], rel=1e-5)
    for m in found:
        assert np.linalg.norm(m.normal) == pytest.approx(1, abs=1e-6)
        # The scene's box is 6 across; a face's middle lies in its plane.
        assert abs(m.normal @ (m.low + m.high) / 2 - m.offset) < 1e-5


def test_coplanar_faces_of_several_shapes_are_one_mirror(mono: ModuleType) -> None:
    move = mono.ScalarTransform4f()
    found = find_mirrors(
        scene(
            mono,
            a={"type": "rectangle", "bsdf": ROUGH, "to_world": move.translate([-2, 0, 1])},
            b={
                "type": "rectangle",
                "bsdf": ROUGH,
                "to_world": move.translate([2, 0, 1]).rotate([1, 0, 0], 180),
            },
        )
    )
    assert len(found) == 1
    assert found[0].area == pytest.approx(8, rel=1e-5)
    np.testing.assert_allclose(found[0].low, [-3, -1, 1], atol=1e-5)
    np.testing.assert_allclose(found[0].high, [3, 1, 1], atol=1e-5)


@pytest.mark.parametrize(
    "shape",
    [
        {"type": "cube", "bsdf": {"type": "diffuse"}},
        {"type": "cube", "bsdf": {"type": "dielectric"}},
        {"type": "cube", "bsdf": {"type": "null"}},
        {"type": "cube", "bsdf": {"type": "plastic"}},
        {"type": "sphere", "bsdf": ROUGH},
    ],
)
def test_diffuse_smooth_and_curved_faces_are_no_mirrors(
    mono: ModuleType, shape: dict[str, Any]
) -> None:
    assert find_mirrors(scene(mono, shape=shape)) == []


def test_the_largest_planes_are_kept(mono: ModuleType) -> None:
    shapes = {
        f"r{i}": {
            "type": "rectangle",
            "bsdf": ROUGH,
            "to_world": mono.ScalarTransform4f().translate([0, 0, i]).scale(10 + i),
        }
        for i in range(MIRRORS_MAX + 4)
    }
    found = find_mirrors(scene(mono, **shapes))
    assert [round(m.area) for m in found] == [
        4 * (10 + i) ** 2 for i in range(MIRRORS_MAX + 3, 3, -1)
    ]


@pytest.mark.parametrize("kind", ["roughdielectric", "roughconductor"])
@pytest.mark.parametrize("alpha", [0.02, 0.1, 0.3])
def test_the_slope_of_a_beckmann_face_is_its_alpha_over_root_two(
    mono: ModuleType, kind: str, alpha: float
) -> None:
    bsdf = mono.load_dict({"type": kind, "distribution": "beckmann", "alpha": alpha})
    assert measured_slope(bsdf) == pytest.approx(alpha / np.sqrt(2), rel=0.15)


def test_glass_reflects_little_from_outside_and_everything_beyond_the_critical_angle(
    mono: ModuleType,
) -> None:
    bsdf = mono.load_dict(ROUGH | {"alpha": 0.05})
    behind, before = measured_reflectance(bsdf)
    # Fresnel at normal incidence: ((n - 1) / (n + 1))^2 = 0.028.
    assert before[-1] == pytest.approx(0.028, abs=0.02)
    assert behind[-1] == pytest.approx(0.028, abs=0.02)
    # The critical cosine is sqrt(1 - 1 / n^2) = 0.70.
    total = (np.arange(COSINE_BINS) + 1) / COSINE_BINS < 0.6
    assert (behind[total] > 0.9).all()
    assert (before >= REFLECTANCE_MIN).all()


def test_a_face_turned_over_has_its_sides_exchanged(mono: ModuleType) -> None:
    move = mono.ScalarTransform4f()
    tables = [
        find_mirrors(
            scene(
                mono,
                a={"type": "rectangle", "bsdf": ROUGH, "to_world": move.rotate([1, 0, 0], angle)},
            )
        )[0].reflectance
        for angle in (0, 180)
    ]
    np.testing.assert_allclose(tables[0], tables[1][::-1])
