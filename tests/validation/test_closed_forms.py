"""Scenes whose radiance is known: furnaces, lit planes, absorbing and thinly scattering slabs."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.validation.film import LONG, camera, check_truth, diffuse, gray, ours

KINDS = ["bdpt", "pssmlt"] if LONG else ["bdpt"]
SPP = 16384 if LONG else 1024
WHITE = [("bdpt", 0.5), ("pssmlt", 0.5), ("bdpt", 0.9)]
FACES = [("bdpt", 1.0), ("bdpt", 1.5)]
LOBES = [("bdpt", -0.5), ("bdpt", 0.8)]
if LONG:
    WHITE += [("pssmlt", 0.9)]
    FACES += [("pssmlt", 1.0), ("pssmlt", 1.5)]
    LOBES += [("bdpt", 0.0), ("pssmlt", -0.5), ("pssmlt", 0.0), ("pssmlt", 0.8)]
FINE = 12


def pixel_rays(size: int, fov: float) -> np.ndarray:
    """Return unit directions ``(row, column, sub, xyz)`` of a camera at -z that looks along +z.

    Mitsuba's image x runs towards -x of the scene then; ``sub`` are FINE^2 points of a pixel.
    """
    half = np.tan(np.radians(fov / 2))
    across = (1 - 2 * (np.arange(size * FINE) + 0.5) / (size * FINE)) * half
    x, y = np.meshgrid(across, across)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    cut = rays.reshape(size, FINE, size, FINE, 3).swapaxes(1, 2)
    return np.asarray(cut.reshape(size, size, FINE * FINE, 3))


@pytest.mark.parametrize(("kind", "albedo"), WHITE)
def test_every_wall_of_a_furnace_shows_what_it_emits_over_one_minus_albedo(
    mono: ModuleType, kind: str, albedo: float
) -> None:
    room = {
        "type": "cube", "flip_normals": True, "bsdf": diffuse(mono, albedo),
        "emitter": {"type": "area", "radiance": gray(mono, 2.0)},
    }  # fmt: skip
    scene = mono.load_dict(
        {"type": "scene", "room": room, "sensor": camera(mono, [0.3, -0.2, -0.9])}
    )
    images = ours(mono, scene, kind, SPP // 2)
    check_truth(images, 2.0 / (1 - albedo), f"furnace, albedo {albedo}, {kind}")


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_max_depth_cuts_the_furnaces_series_where_it_says(mono: ModuleType, depth: int) -> None:
    room = {
        "type": "cube", "flip_normals": True, "bsdf": diffuse(mono, 0.5),
        "emitter": {"type": "area", "radiance": gray(mono, 2.0)},
    }  # fmt: skip
    scene = mono.load_dict({"type": "scene", "room": room, "sensor": camera(mono, [0, 0, -0.9])})
    images = ours(mono, scene, "bdpt", SPP // 2, max_depth=depth)
    check_truth(images, 2.0 * (1 - 0.5**depth) / 0.5, f"furnace, {depth} edges")


@pytest.mark.parametrize("kind", KINDS)
def test_an_integrating_sphere_is_equally_bright_everywhere(mono: ModuleType, kind: str) -> None:
    radius, albedo, intensity = 1.5, 0.8, 3.0
    scene = mono.load_dict(
        {
            "type": "scene",
            "wall": {
                "type": "sphere", "radius": radius, "flip_normals": True,
                "bsdf": diffuse(mono, albedo),
            },
            "lamp": {"type": "point", "position": [0, 0, 0], "intensity": gray(mono, intensity)},
            "sensor": camera(mono, [0, 0, -1.2]),
        }
    )  # fmt: skip
    truth = albedo / (np.pi * (1 - albedo)) * intensity / radius**2
    check_truth(ours(mono, scene, kind, SPP // 2), truth, f"integrating sphere, {kind}")


@pytest.mark.parametrize("kind", ["bdpt", "pssmlt"])
def test_two_points_and_a_lamp_over_a_plane_add_up(mono: ModuleType, kind: str) -> None:
    points = [([0.6, 0.3, -2.0], 3.0), ([-1.0, 0.5, -0.8], 0.5)]
    transform = mono.ScalarTransform4f()
    # The lamp lies beside what the camera sees.
    lamp, side, radiance, albedo = np.array([3.0, 0.0, -1.0]), 0.5, 4.0, 0.5
    content: dict[str, Any] = {
        "type": "scene",
        "plane": {
            "type": "rectangle", "to_world": transform.rotate([1, 0, 0], 180).scale(100),
            "bsdf": diffuse(mono, albedo),
        },
        "lamp": {
            "type": "rectangle", "to_world": transform.translate(lamp.tolist()).scale(side),
            "bsdf": diffuse(mono, 0.0),
            "emitter": {"type": "area", "radiance": gray(mono, radiance)},
        },
        "sensor": camera(mono, [0, 0, -5], fov=40),
    }  # fmt: skip
    for i, (position, intensity) in enumerate(points):
        content[f"point{i}"] = {
            "type": "point", "position": position, "intensity": gray(mono, intensity),
        }  # fmt: skip
    rays = pixel_rays(8, 40)
    hit = np.array([0, 0, -5.0]) + rays * (5.0 / rays[..., 2:])
    irradiance = np.zeros(hit.shape[:-1])
    for position, intensity in points:
        span = np.array(position) - hit
        irradiance += intensity * -span[..., 2] / np.linalg.norm(span, axis=-1) ** 3
    nodes, weights = np.polynomial.legendre.leggauss(8)
    for u, wu in zip(nodes, weights, strict=True):
        for v, wv in zip(nodes, weights, strict=True):
            span = lamp + side * np.array([u, v, 0.0]) - hit
            share = radiance * span[..., 2] ** 2 / np.linalg.norm(span, axis=-1) ** 4
            irradiance += side**2 * wu * wv * share
    truth = (albedo / np.pi * irradiance).mean(axis=-1)[..., None]
    images = ours(mono, mono.load_dict(content), kind, SPP)
    check_truth(images, truth, f"plane under two points and a lamp, {kind}")


@pytest.mark.parametrize("kind", KINDS)
def test_a_plane_under_a_spot_a_directional_light_and_a_sky_adds_up(
    mono: ModuleType, kind: str
) -> None:
    transform = mono.ScalarTransform4f()
    albedo, sky, irradiance, intensity = 0.5, 0.7, 2.0, 9.0
    cutoff, beam = np.radians(25), np.radians(10)
    position, axis = np.array([0.5, 0.0, -4.0]), np.array([-0.3, 0.2, 1.0])
    axis /= np.linalg.norm(axis)
    falling = np.array([0.5, 0.3, 1.0]) / np.linalg.norm([0.5, 0.3, 1.0])
    content: dict[str, Any] = {
        "type": "scene",
        "plane": {
            "type": "rectangle", "to_world": transform.rotate([1, 0, 0], 180).scale(20),
            "bsdf": diffuse(mono, albedo),
        },
        "sky": {"type": "constant", "radiance": gray(mono, sky)},
        "sun": {
            "type": "directional", "direction": falling.tolist(),
            "irradiance": gray(mono, irradiance),
        },
        "spot": {
            "type": "spot", "cutoff_angle": float(np.degrees(cutoff)),
            "beam_width": float(np.degrees(beam)), "intensity": gray(mono, intensity),
            "to_world": transform.look_at(
                origin=position.tolist(), target=(position + axis).tolist(), up=[0, 1, 0]
            ),
        },
        "sensor": camera(mono, [0, 0, -5], fov=40),
    }  # fmt: skip
    rays = pixel_rays(8, 40)
    hit = np.array([0, 0, -5.0]) + rays * (5.0 / rays[..., 2:])
    span = hit - position
    distance = np.linalg.norm(span, axis=-1)
    angle = np.arccos(np.clip((span @ axis) / distance, -1.0, 1.0))
    beamed = intensity * np.clip((cutoff - angle) / (cutoff - beam), 0.0, 1.0)
    lit = beamed * span[..., 2] / distance**3 + irradiance * falling[2] + np.pi * sky
    truth = (albedo / np.pi * lit).mean(axis=-1)[..., None]
    images = ours(mono, mono.load_dict(content), kind, SPP)
    check_truth(images, truth, f"plane under spot, sun and sky, {kind}")


def absorber(mono: ModuleType, face: dict[str, Any], sigma_t: float, **parts: Any) -> Any:
    """Return a wide slab, 0 < z < 1, before a camera at z = -2, and what is behind it."""
    transform = mono.ScalarTransform4f()
    medium = {"type": "homogeneous", "sigma_t": sigma_t, "albedo": 0.0}
    slab = {
        "type": "cube", "to_world": transform.translate([0, 0, 0.5]).scale([60, 60, 0.5]),
        "bsdf": face, "interior": medium | parts.pop("medium", {}),
    }  # fmt: skip
    return mono.load_dict(
        {"type": "scene", "slab": slab, "sensor": camera(mono, [0, 0, -2], fov=70), **parts}
    )


def fresnel(cosine: np.ndarray, index: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the reflectance of a face for unpolarized light and the cosine behind it."""
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (inside - index * cosine) / (inside + index * cosine)
    return 0.5 * (s**2 + p**2), inside


def backlight(mono: ModuleType, radiance: float) -> dict[str, Any]:
    """Return a black wall at z = 2 that shines towards -z."""
    to_world = mono.ScalarTransform4f().translate([0, 0, 2]).rotate([0, 1, 0], 180).scale(500)
    return {
        "type": "rectangle", "to_world": to_world, "bsdf": diffuse(mono, 0.0),
        "emitter": {"type": "area", "radiance": gray(mono, radiance)},
    }  # fmt: skip


def test_a_thin_pane_passes_what_it_does_not_reflect(mono: ModuleType) -> None:
    pane = {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}
    scene = mono.load_dict(
        {
            "type": "scene",
            "pane": {
                "type": "rectangle", "to_world": mono.ScalarTransform4f().scale(60), "bsdf": pane,
            },
            "behind": backlight(mono, 3.0),
            "sensor": camera(mono, [0, 0, -2], fov=120),
        }
    )  # fmt: skip
    once, _ = fresnel(pixel_rays(8, 120)[..., 2], 1.5)
    truth = 3.0 * (1 - 2 * once / (1 + once)).mean(axis=-1)[..., None]
    check_truth(ours(mono, scene, "bdpt", SPP), truth, "thin pane")


@pytest.mark.parametrize(("kind", "index"), FACES)
def test_light_through_an_absorbing_slab_follows_beer_and_fresnel(
    mono: ModuleType, kind: str, index: float
) -> None:
    sigma_a = 0.7
    face: dict[str, Any] = {"type": "null"}
    if index > 1:
        face = {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}
    scene = absorber(mono, face, sigma_a, behind=backlight(mono, 3.0))
    reflected, inside = fresnel(pixel_rays(8, 70)[..., 2], index)
    passed = np.exp(-sigma_a / inside)
    series = (1 - reflected) ** 2 * passed / (1 - (reflected * passed) ** 2)
    truth = (3.0 * series).mean(axis=-1)[..., None]
    check_truth(ours(mono, scene, kind, SPP), truth, f"absorbing slab, index {index}, {kind}")


@pytest.mark.parametrize(("kind", "g"), LOBES)
def test_single_scattering_in_a_slab_is_the_integral_along_the_ray(
    mono: ModuleType, kind: str, g: float
) -> None:
    sigma_t, albedo, intensity = 0.9, 0.4, 6.0
    lamp = np.array([0.7, 0.4, 2.2])
    scene = absorber(
        mono, {"type": "null"}, sigma_t,
        medium={"albedo": albedo, "phase": {"type": "hg", "g": g}},
        lamp={"type": "point", "position": lamp.tolist(), "intensity": gray(mono, intensity)},
    )  # fmt: skip
    rays = pixel_rays(8, 70)
    nodes, weights = np.polynomial.legendre.leggauss(64)
    truth = np.zeros(rays.shape[:-1])
    for u, w in zip(0.5 + 0.5 * nodes, 0.5 * weights, strict=True):
        at = np.array([0, 0, -2.0]) + rays * ((2 + u) / rays[..., 2:])
        span = lamp - at
        distance = np.linalg.norm(span, axis=-1)
        # The angle by which light is turned on its way from the lamp to the camera.
        cosine = (span * rays).sum(axis=-1) / distance
        phase = (1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * cosine) ** 1.5)
        depth = sigma_t * (u / rays[..., 2] + (1 - u) * distance / span[..., 2])
        share = sigma_t * albedo * phase * intensity / distance**2 * np.exp(-depth)
        truth += w * share / rays[..., 2]
    images = ours(mono, scene, kind, SPP, max_depth=2)
    check_truth(images, truth.mean(axis=-1)[..., None], f"single scattering, g {g}, {kind}")
