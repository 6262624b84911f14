"""Directions go to mirror images with the density that they state."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.cells.lower_face_mirror import LowerFaceMirror
from render.geometry import bend_points
from render.scene import Scene, load_scene

COUNT = 1 << 16
BENDS = pytest.mark.parametrize("bend", [0.0, np.pi / 2])
RINGS, SECTORS = 1024, 64


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


def points(mono: ModuleType, scene: Scene, bend: float, count: int) -> tuple[Any, Any]:
    """Return a point of the coating and one in the diffuser, once per lane."""
    flat = np.array([[1.0, 4.0, 4.0], [-7.5, 2.0, 2.0]])
    return tuple(
        mono.Point3f(np.repeat(p[:, None], count, axis=1).astype(np.float32))
        for p in bend_points(scene, flat, bend)
    )


def axis(mono: ModuleType, mirror: LowerFaceMirror, scene: Scene, bend: float) -> np.ndarray:
    a, y = points(mono, scene, bend, 1)
    return np.array(
        mirror.lobe(a, y).sample(mono.Float([0.0]), mono.Float([0.0])), dtype=np.float64
    )[:, 0]


def polar(center: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return directions about ``center``, their solid angles and their angles to it."""
    edges = np.concatenate([[0.0], np.geomspace(1e-4, np.pi / 2, RINGS)])
    theta = 0.5 * (edges[1:] + edges[:-1])
    phi = 2 * np.pi * np.arange(SECTORS) / SECTORS
    solid = (np.cos(edges[:-1]) - np.cos(edges[1:])) * 2 * np.pi / SECTORS
    helper = np.eye(3)[np.abs(center).argmin()]
    u = np.cross(center, helper)
    u /= np.linalg.norm(u)
    v = np.cross(center, u)
    ring = np.cos(phi)[:, None] * u + np.sin(phi)[:, None] * v
    d = np.cos(theta)[:, None, None] * center + np.sin(theta)[:, None, None] * ring
    return d.reshape(-1, 3), np.repeat(solid, SECTORS), np.repeat(theta, SECTORS)


@BENDS
def test_the_density_integrates_to_one_and_is_that_of_the_sampled_directions(
    mono: ModuleType, scene: Scene, bend: float
) -> None:
    mirror = LowerFaceMirror(scene, bend)
    center = axis(mono, mirror, scene, bend)
    d, solid, theta = polar(center / np.linalg.norm(center))
    a, y = points(mono, scene, bend, len(d))
    density = np.array(
        mirror.lobe(a, y).density(mono.Vector3f(np.ascontiguousarray(d.T).astype(np.float32)))
    )
    assert np.isfinite(density).all()
    share = density.astype(np.float64) * solid
    assert share.sum() == pytest.approx(1.0, abs=2e-3)

    a, y = points(mono, scene, bend, COUNT)
    rng = np.random.default_rng(1)
    u, v = (mono.Float(rng.random(COUNT).astype(np.float32)) for _ in range(2))
    drawn = np.array(mirror.lobe(a, y).sample(u, v), dtype=np.float64).T
    angles = np.arccos(np.clip(drawn @ center / np.linalg.norm(center), -1, 1))
    for limit in (0.05, 0.1, 0.2, 0.5):
        expected = share[theta < limit].sum()
        error = np.sqrt(expected * (1 - expected) / COUNT)
        # The rings are finite: 2e-3 of the mass may fall on the other side of the limit.
        assert abs((angles < limit).mean() - expected) < 4 * error + 4e-3


@BENDS
def test_directions_go_where_a_mirror_would_reflect(
    mono: ModuleType, scene: Scene, bend: float
) -> None:
    d = axis(mono, LowerFaceMirror(scene, bend), scene, bend)
    a, y = (np.array(p, dtype=np.float64)[:, 0] for p in points(mono, scene, bend, 1))
    # March to the face, then compare the mirrored direction with the way to the light vertex.
    radius = scene.pad.length / bend if bend else 0.0
    steps = np.linspace(0, 40, 400_001)[1:]
    way = a + steps[:, None] * d
    if bend:
        outside = np.hypot(way[:, 1] - scene.camera.y, way[:, 2] - scene.pad.thickness - radius)
        below = outside > radius + scene.pad.thickness
    else:
        below = way[:, 2] < 0
    b = way[below.argmax()]
    normal = np.array([0.0, 0.0, 1.0])
    if bend:
        normal = np.array([0.0, scene.camera.y - b[1], scene.pad.thickness + radius - b[2]])
        normal /= np.linalg.norm(normal)
    reflected = d - 2 * (d @ normal) * normal
    towards = (y - b) / np.linalg.norm(y - b)
    assert np.degrees(np.arccos(reflected @ towards)) < (4.0 if bend else 0.1)


@pytest.mark.parametrize("bend", [0.0, 1e-9, 1.0, np.pi])
def test_light_vertices_anywhere_on_the_pad_give_finite_directions_and_densities(
    mono: ModuleType, scene: Scene, bend: float
) -> None:
    mirror = LowerFaceMirror(scene, bend)
    # The first two are on the coating, where mirror connections start.
    corners = np.array([[0, 3, 4], [9, -12, 4], [0, 3, 0], [-9, 18, 2.0]])
    there = bend_points(scene, corners, bend).astype(np.float32)
    first, second = (grid.ravel() for grid in np.meshgrid(range(2), range(4)))
    a = mono.Point3f(np.ascontiguousarray(there[first].T))
    y = mono.Point3f(np.ascontiguousarray(there[second].T))
    half = mono.Float(np.full(8, 0.5, dtype=np.float32))
    d = mirror.lobe(a, y).sample(half, half)
    density = mirror.lobe(a, y).density(d)
    dr.eval(d, density)
    assert np.isfinite(np.array(d)).all()
    assert np.isfinite(np.array(density)).all()
    assert (np.array(density) >= 0).all()
