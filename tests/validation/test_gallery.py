"""Surfaces, lenses and meshes of Mitsuba's gallery look as Mitsuba's own ``path`` finds them."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import trimesh

from tests.validation.film import LONG, camera, check_same, diffuse, gray, ours, theirs
from tests.validation.lamps import above, open_room
from tests.validation.rooms import ball, glass

SPP = 16384 if LONG else 1024


def texture(mono: ModuleType) -> dict[str, Any]:
    pixels = np.random.default_rng(2).random((4, 8, 1)).astype(np.float32)
    return {"type": "bitmap", "raw": True, "bitmap": mono.Bitmap(pixels)}


SURFACES: dict[str, Any] = {
    "plastic": lambda mono: {"type": "plastic", "diffuse_reflectance": gray(mono, 0.4)},
    "textured rough plastic": lambda mono: {
        "type": "roughplastic", "alpha": 0.15, "diffuse_reflectance": texture(mono),
    },
    "conductor": lambda _: {"type": "conductor", "eta": 0.2, "k": 3.9},
    "rough conductor": lambda _: {"type": "roughconductor", "alpha": 0.2, "eta": 0.2, "k": 3.9},
    "principled": lambda mono: {
        "type": "principled", "base_color": gray(mono, 0.6), "metallic": 0.4, "roughness": 0.3,
        "clearcoat": 0.5, "specular": 0.5,
    },
    "principled glass": lambda mono: {
        "type": "principled", "base_color": gray(mono, 0.9), "roughness": 0.3, "spec_trans": 0.8,
    },
    "mask": lambda mono: {
        "type": "mask", "opacity": 0.4,
        "nested": {"type": "twosided", "inner": diffuse(mono, 0.5)},
    },
    "blend": lambda mono: {
        "type": "blendbsdf", "weight": 0.4, "inner": diffuse(mono, 0.5),
        "other": {"type": "roughconductor", "alpha": 0.3, "eta": 0.2, "k": 3.9},
    },
}  # fmt: skip


def lit(mono: ModuleType, **objects: Any) -> Any:
    """Return the open room under a disk and a faint sky."""
    emitter = {"type": "area", "radiance": gray(mono, 6.0)}
    sky = {"type": "constant", "radiance": gray(mono, 0.3)}
    return open_room(mono, lamp=above(mono, "disk", 0.6, emitter), sky=sky, **objects)


def check_as_by_path(mono: ModuleType, scene: Any, what: str) -> None:
    check_same(ours(mono, scene, "bdpt", SPP), theirs(mono, scene, "path", SPP), what)


@pytest.mark.parametrize("surface", SURFACES if LONG else ["textured rough plastic", "mask"])
def test_a_ball_of_any_surface_looks_as_by_path(mono: ModuleType, surface: str) -> None:
    check_as_by_path(mono, lit(mono, ball=ball(0.0, SURFACES[surface](mono))), surface)


def test_brushed_metal_shines_along_the_parameters_of_its_surface(mono: ModuleType) -> None:
    transform = mono.ScalarTransform4f()
    plate = {
        "type": "rectangle",
        "to_world": transform.translate([0, -0.9, 0]).rotate([0, 1, 0], 30).rotate([1, 0, 0], -90),
        "bsdf": {
            "type": "roughconductor", "alpha_u": 0.05, "alpha_v": 0.4, "eta": 0.2, "k": 3.9,
        },
    }  # fmt: skip
    check_as_by_path(mono, lit(mono, plate=plate), "brushed metal")


def test_meshes_with_normals_of_their_vertices_look_as_by_path(
    mono: ModuleType, tmp_path: Path
) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.65)
    mesh.apply_translation([0, -0.3, 0])
    content: Any = mesh.export(file_type="ply", vertex_normal=True)
    path = tmp_path / "ball.ply"
    path.write_bytes(content)
    ply = {"type": "ply", "filename": str(path)}
    smooth = lit(mono, ball={**ply, "bsdf": diffuse(mono, 0.8)})
    images, truth = ours(mono, smooth, "bdpt", 4 * SPP), theirs(mono, smooth, "path", 4 * SPP)
    check_same(images, truth, "smooth mesh")


def test_a_thin_lens_blurs_as_by_path_also_between_close_clipping_planes(
    mono: ModuleType,
) -> None:
    sensor = camera(mono, [0, 0.5, 4], fov=45, target=(0, -0.3, 0)) | {
        "type": "thinlens", "aperture_radius": 0.3, "focus_distance": 4.0, "near_clip": 2.0,
        "far_clip": 8.0,
    }  # fmt: skip
    scene = lit(mono, ball=ball(0.0, glass(0.3)), sensor=sensor)
    check_as_by_path(mono, scene, "thin lens")


def test_instances_of_a_group_of_shapes_look_as_by_path(mono: ModuleType) -> None:
    transform = mono.ScalarTransform4f()
    cube = {"type": "cube", "to_world": transform.scale(0.4), "bsdf": diffuse(mono, 0.8)}
    placed = {
        f"copy{x}": {
            "type": "instance", "group": {"type": "ref", "id": "cubes"},
            "to_world": transform.translate([x, -0.4, 0]).rotate([0, 1, 0], 30 * x),
        }
        for x in (-1, 1)
    }  # fmt: skip
    cubes = {"type": "shapegroup", "cube": cube}
    check_as_by_path(mono, lit(mono, cubes=cubes, **placed), "instances")
