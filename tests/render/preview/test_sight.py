"""What pixels see of pads, against rays cast at the triangles of meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from render.geometry import HeightMap, camera_axes, camera_origin, half_view, probe
from render.preview import Preview
from render.preview.sight import Sight
from render.scene import Scene
from tests.oracles.pads import scene_of_case
from tests.oracles.skin_bodies import body_under

SIZE = 40, 32
HEIGHTS = {
    "dome": lambda x, y: 6.0 + np.sqrt(30.0**2 - x**2 - y**2) - 30.0,
    "arch": lambda x, y: 6.0 + np.sqrt(20.0**2 - x**2) - 20.0,
    "arch along x rough 0.1": lambda x, y: 6.0 + np.sqrt(20.0**2 - y**2) - 20.0,
}


def sight_of(scene: Scene, cache: Path, imprint: HeightMap | None = None, finer: int = 1) -> Sight:
    """Return what the pixels of a picture see, with or without a body."""
    with Preview(scene, cache=cache, imprint=imprint) as preview:
        width, height = (finer * side for side in SIZE)
        return preview.sight(0.0, width, height, indented=imprint is not None)


def refracted(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return where the rays of all pixels enter the plane z = 0, and their ways inside (Snell)."""
    right, down, ahead = camera_axes(scene)
    columns, rows = SIZE
    x, y = np.meshgrid(
        2 * (np.arange(columns) + 0.5) / columns - 1, 2 * (np.arange(rows) + 0.5) / rows - 1
    )
    wide, high = half_view(scene, *SIZE)
    way = -right * (x * wide)[..., None] - down * (y * high)[..., None] + ahead
    way = (way / np.linalg.norm(way, axis=-1, keepdims=True)).reshape(-1, 3)
    camera = camera_origin(scene)
    entry = camera + way * (-camera[2] / way[:, 2])[:, None]
    inside = way / scene.pad.index
    inside[:, 2] = np.sqrt(1 - (inside[:, :2] ** 2).sum(axis=-1))
    return entry, inside


def cast(
    triangles: np.ndarray, start: np.ndarray, way: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the way to the first triangle and its number (Moeller and Trumbore 1997)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    length, number = np.full(len(start), np.inf), np.zeros(len(start), dtype=int)
    for i, (p, d) in enumerate(zip(start, way, strict=True)):
        h = np.cross(d, c - a)
        det = (h * (b - a)).sum(axis=-1)
        s = p - a
        q = np.cross(s, b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = (s * h).sum(axis=-1) / det, q @ d / det
            t = ((c - a) * q).sum(axis=-1) / det
        good = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        if good.any():
            number[i] = np.flatnonzero(good)[t[good].argmin()]
            length[i] = t[number[i]]
    return length, number


@pytest.mark.parametrize("case", list(HEIGHTS))
def test_pixels_see_where_rays_meet_a_curved_skin(case: str, tmp_path: Path) -> None:
    scene = scene_of_case(case)
    skin = body_under(HEIGHTS[case], (scene.pad.width, scene.pad.length), 60)
    upper = skin.triangles[skin.face_normals[:, 2] > 0.1]
    entry, inside = refracted(scene)
    way, triangle = cast(upper, entry, inside)
    meets = entry + way[:, None] * inside
    seen = sight_of(scene, tmp_path)
    half = np.array([scene.pad.width, scene.pad.length]) / 2
    (hit,) = np.nonzero(np.isfinite(way) & (np.abs(entry[:, :2]) < half).all(axis=-1))
    both, mine, _ = np.intersect1d(seen.pixel, hit, return_indices=True)
    assert len(both) > 0.97 * max(len(hit), len(seen.pixel)) > 300
    away = np.linalg.norm(seen.position[mine] - meets[both], axis=-1)
    assert np.percentile(away, 99) < 0.01
    a, b, c = np.moveaxis(upper[triangle[both]], 1, 0)
    normal = np.cross(c - a, b - a)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    assert np.percentile(np.abs(seen.facing[mine] - normal), 99) < 0.03


@pytest.mark.parametrize("case", list(HEIGHTS))
def test_pixels_see_a_ball_from_a_file_where_it_is_pressed_into_a_curved_skin(
    case: str, tmp_path: Path
) -> None:
    scene = scene_of_case(case)
    trimesh.creation.icosphere(subdivisions=5, radius=3.0).export(tmp_path / "ball.stl")
    skin = probe(scene, str(tmp_path / "ball.stl"), depth=1.0, smoothing=0.0)
    assert isinstance(skin, HeightMap)
    seen = sight_of(scene, tmp_path, skin, finer=3)
    # Its middle lies above the middle of the sites (0, 1) on the normal of the skin there.
    height, step = HEIGHTS[case], 1e-5
    slope = (height(0.0, 1.0 + step) - height(0.0, 1.0 - step)) / (2 * step)
    out = np.array([0.0, -slope, 1.0]) / np.hypot(slope, 1.0)
    middle = np.array([0.0, 1.0, height(0.0, 1.0)]) + 2.0 * out
    untouched = height(*seen.position[:, :2].T) - seen.position[:, 2]
    on_ball, beside = untouched > 0.05, untouched < 0.005
    assert on_ball.sum() > 100
    assert (on_ball | beside).mean() > 0.97
    away = seen.position[on_ball] - middle
    far = np.linalg.norm(away, axis=-1)
    assert np.percentile(np.abs(far - 3.0), 95) < 0.02
    # The deepest place is 1 mm below the skin, and normals point from the middle into the pad.
    assert (away @ -out).max() == pytest.approx(3.0, abs=0.05)
    turned = (seen.facing[on_ball] * away / far[:, None]).sum(axis=-1)
    assert np.percentile(turned, 10) > np.cos(np.radians(3.0))
