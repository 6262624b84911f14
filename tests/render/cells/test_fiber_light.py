"""Light rays of fibers and their weights for many directions at once."""

from __future__ import annotations

from types import ModuleType

import drjit as dr
import numpy as np
import pytest

from render.cells.fiber_light import FiberLight
from render.geometry import fiber_poses
from render.optics.fiber_profile import peak_radiance, truncated_mass
from render.scene import Scene, load_scene

COUNT = 100_000


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


def drawn(mono: ModuleType, light: FiberLight, fiber: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions and the weights ``(node, ray)`` of rays of one fiber."""
    rng = np.random.default_rng(5)
    pick, u, v, x, y = (mono.Float(rng.random(COUNT).astype(np.float32)) for _ in range(5))
    lanes = mono.UInt32(np.full(COUNT, fiber, dtype=np.uint32))
    o, d = light.sample(lanes, pick, (u, v), mono.Point2f(x, y))
    nodes = light.weights(lanes, o, d)
    dr.eval(nodes, d)
    weights = np.array([np.array(node) for node in nodes], dtype=np.float64)
    return np.array(d, dtype=np.float64).T, weights


@pytest.mark.parametrize("bend", [0.0, np.pi / 2])
@pytest.mark.parametrize("fiber", [0, 9, 19])
def test_every_direction_node_emits_unit_power(
    mono: ModuleType, scene: Scene, fiber: int, bend: float
) -> None:
    phi = np.tile(np.linspace(0.2, np.pi - 0.2, 5), (scene.lamp_count, 1))
    _, weights = drawn(mono, FiberLight(scene, phi, bend), fiber)
    error = weights.std(axis=1) / np.sqrt(COUNT)
    assert np.isfinite(weights).all()
    assert (np.abs(weights.mean(axis=1) - 1.0) < 4 * error).all()


def test_with_one_node_the_weight_is_the_ratio_of_power_to_sampling_density(
    mono: ModuleType, scene: Scene
) -> None:
    phi = np.full((scene.lamp_count, 1), np.pi / 2)
    directions, weights = drawn(mono, FiberLight(scene, phi, 0.0), 4)
    sigma_v, area = scene.fibers.sigma_v, np.pi * (scene.fibers.diameter / 2) ** 2
    beam = fiber_poses(scene, 0.0).directions(phi[:, 0])[4]
    cosine = np.clip(directions @ beam, -1, 1)
    theta = np.arccos(cosine)
    scale = peak_radiance(sigma_v, area) * area * 4 * np.pi * sigma_v**2 * truncated_mass(sigma_v)
    expected = scale * cosine * np.sinc(theta / np.pi)
    safe = cosine > 0.01
    np.testing.assert_allclose(weights[0][safe], expected[safe], rtol=2e-3)


@pytest.mark.parametrize("nodes", [[1.2], [0.05, 2.4], [0.05, 2.4, 2.4, 3.0]])
def test_directions_to_points_of_end_faces_have_a_density_of_unit_integral(
    mono: ModuleType, scene: Scene, nodes: list[float]
) -> None:
    # Some turn their backs to a point of the face beside the lamp, with others behind them.
    light = FiberLight(scene, np.tile(nodes, (scene.lamp_count, 1)), 0.0)
    poses, lamp, steps = fiber_poses(scene, 0.0), 4, 1500
    # The middle of each step of a sphere about the point.
    cosine = (2 * np.arange(steps) + 1) / steps - 1
    azimuth = np.pi * (2 * np.arange(steps) + 1) / steps
    z, around = (grid.ravel() for grid in np.meshgrid(cosine, azimuth))
    ring = np.sqrt(1 - z**2)
    lines = np.stack([ring * np.cos(around), ring * np.sin(around), z]).astype(np.float32)
    lanes = mono.UInt32(np.full(len(z), lamp, dtype=np.uint32))
    point = mono.Point3f(poses.foot[lamp] + 0.8 * poses.along[lamp])
    density = np.array(light.ray(lanes, point, -mono.Vector3f(lines)).joined, dtype=np.float64)
    assert abs(4 * np.pi * density.mean() - 1.0) < 0.01


def test_a_line_in_the_pad_passes_no_lamp_that_is_nearer_than_it_is_wide(mono: ModuleType) -> None:
    mini = load_scene("gelsight-mini")
    phi = np.full((mini.lamp_count, 1), np.pi / 2)
    light, poses = FiberLight(mini, phi, 0.0), fiber_poses(mini, 0.0)
    gap = float(np.linalg.norm(poses.position[0] - poses.foot[0]))
    assert gap < poses.radius[0]
    # From the pad aslant to the wall, 0.3 mm beside the lamp's foot; then on through the air.
    inward, along = poses.inward[0], poses.along[0]
    wall = poses.foot[0] + 0.3 * along
    inside, outside = wall + 2.0 * inward + 2.0 * along, poses.position[0] - wall
    lane = mono.UInt32([0])

    def passed(start: np.ndarray, way: np.ndarray, length: float) -> bool:
        direction = mono.Vector3f(way / np.linalg.norm(way))
        return bool(light.passed(lane, mono.Point3f(start), direction, mono.Float(length))[0])

    assert not passed(inside, wall - inside, float(np.linalg.norm(wall - inside)))
    assert passed(wall, outside, np.inf)
    # Reflected in the wall beside the lamp, and away from it.
    assert not passed(wall, inward + along, np.inf)
