"""A toy of the light with a known, simple physics: fits are quick and truths are known."""

from __future__ import annotations

import numpy as np

from hw.calibration.line_model import LineModel
from hw.calibration.log_ratio import field_modes
from hw.calibration.material import material_space
from hw.calibration.material_table import MaterialTable, fitted_table
from hw.calibration.measurement import Measurement
from hw.calibration.reference_lines import frame_positions, reference_lines
from hw.camera.photo_set import PhotoSet
from hw.camera.projection import pad_positions
from hw.emulator.emulated_camera import CameraImperfections, EmulatedCamera
from hw.leds.board import Levels
from render.arrays import Array
from render.geometry import flat_fiber_poses
from render.scene import Scene, load_scene

BENDS = np.array([0.0, np.pi / 2])
SPACE = material_space(load_scene("finger20"))
TRUE = np.array([1.2, 0.02, np.radians(17.0), 0.1])
"""The material of measurements without a camera."""
GAIN = np.array([2.0, 1.7, 1.4]) * 1e5
PHOTOGRAPHED = np.array([1.3, 0.03, np.radians(13.0), 0.1])
"""The material of photographs."""
IMPERFECTIONS = CameraImperfections(
    vignetting=0.15, tilt=(0.006, -0.004, 0.008), gain=(1.0, 0.9, 0.8)
)
"""The camera of photographs."""


def toy_log_light(scene: Scene, material: Array) -> Array:
    """Return log light ``(bend, fiber, point)`` at the reference lines."""
    across, along = frame_positions().T
    drawn = np.stack([toy(material, across, along, bend) for bend in (0, 1)])
    drawn = drawn[:, None].repeat(scene.lamp_count, axis=1)
    return np.where(reference_lines(scene).inside, drawn, np.nan)


def toy_images(scene: Scene, material: Array, rows: int, columns: int) -> Array:
    """Return what the camera sees of each fiber's light, ``(bend, fiber, row, column)``."""
    poses = flat_fiber_poses(scene)
    assert scene.diffuser is not None
    margin = scene.fibers.gap + scene.diffuser.thickness
    images = []
    for bend, angle in enumerate(BENDS):
        flat = pad_positions(scene, float(angle), rows, columns)
        away = flat - poses.position[:, None, None, :2]
        across = np.einsum("frcx,fx->frc", away, poses.along[:, :2])
        along = np.einsum("frcx,fx->frc", away, poses.inward[:, :2]) - margin
        images.append(np.exp(toy(material, across, np.maximum(along, 0.0), bend)))
    return np.nan_to_num(np.stack(images)).astype(np.float32)


def toy(material: Array, across: Array, along: Array, bend: int) -> Array:
    """Return log light at distances (mm) from the fiber's axis and from the pad's edge.

    The beam's width shows across the light, scattering along it, absorption far away.
    """
    scattering, absorption, sigma_v, roughness = material
    width = 2.0 + 6.0 * sigma_v + 0.25 * along
    shape = -np.log(1 + (across / width) ** 2) - 0.4 * np.log(scattering)
    shape = shape - (1.2 + 0.35 * np.log(scattering)) * np.log(along + 2.0)
    shape = shape - 2.0 * absorption * (2.0 + np.hypot(across, along))
    shape = shape + 0.5 * roughness * np.cos(across)
    return np.asarray(shape - 0.05 * along * bend - 5.0)


def toy_table(scene: Scene) -> MaterialTable:
    """Return the toy's table, with a little noise as random walks leave."""
    materials = SPACE.sobol(32)
    drawn = np.stack([toy_log_light(scene, material) for material in materials])
    drawn = drawn + 0.003 * np.random.default_rng(0).standard_normal(drawn.shape)
    return fitted_table(SPACE, materials, drawn)


def toy_model(table: MaterialTable, error: float | Array = 0.005) -> LineModel:
    """Return the toy's model: nothing to correct, errors of relative size ``error`` per bend."""
    nothing = np.zeros(table.coefficients.shape[1:])
    return LineModel(SPACE, table, nothing, field_modes(np.broadcast_to(error, (2,)), 20))


def photographs(
    scene: Scene, seed: int = 0, noise: float = 0.5, fibers: int = 20, true: Array = TRUE
) -> tuple[list[Measurement], Array]:
    """Return measurements of the toy, every other fiber flat and the others bent; true powers."""
    rng = np.random.default_rng(seed)
    power = np.exp(0.08 * rng.standard_normal(20))
    light = toy_log_light(scene, true)
    found = []
    for fiber in range(fibers):
        bend = fiber % 2
        own = np.exp(light[bend, fiber])
        radius2 = rng.uniform(0, 1, own.shape)
        clean = own[:, None] * power[fiber] * GAIN * (1 - 0.15 * radius2)[:, None]
        counts = clean + noise * rng.standard_normal(clean.shape)
        used = np.isfinite(counts).all(axis=1) & (counts > 3).all(axis=1)
        slope = np.where(used[:, None], clean, 0.0) * rng.uniform(-5, 5, (3, len(own), 1))
        tilt = np.array([0.004, -0.003, 0.006])
        counts = counts - np.einsum("tpc,t->pc", slope, tilt)
        found.append(Measurement(fiber, bend, counts, used, [0, 1, 2], noise, radius2, slope))
    return found, power


class FixedBoard:
    """What an emulated camera needs of a board: what its LEDs show."""

    def __init__(self) -> None:
        self.levels: Levels = np.zeros((20, 3), dtype=np.uint8)


def taken(
    scene: Scene, imperfections: CameraImperfections, seed: int = 0
) -> tuple[list[PhotoSet], PhotoSet, Array]:
    """Return 20 photographs, half of them flat and half bent, a linearity sweep, true powers."""
    images = toy_images(scene, PHOTOGRAPHED, 300, 180)
    power = np.exp(0.08 * np.random.default_rng(seed).standard_normal(20))
    bright = float(np.percentile(images, 99.9, axis=(2, 3)).max() * power.max())
    board = FixedBoard()
    cameras = [
        EmulatedCamera(scene, one, board, 200 / bright, power, imperfections, seed)  # type: ignore[arg-type]
        for one in images
    ]

    def photo(bend: int, fibers: list[int], level: int) -> Array:
        board.levels[:] = 0
        board.levels[fibers] = level
        return cameras[bend].capture()

    dark = [np.mean([photo(bend, [], 0) for _ in range(8)], axis=0) for bend in (0, 1)]
    sets = [
        PhotoSet({f: photo(b, [f], 255) - dark[b] for f in range(b, 20, 2)}, None) for b in (0, 1)
    ]
    few = list(range(0, 20, 4))
    together = photo(0, few, 120) - dark[0]
    additive = PhotoSet({f: photo(0, [f], 120) - dark[0] for f in few}, together)
    return sets, additive, power
