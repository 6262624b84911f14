"""The reference lines of a tilted camera, brought back by the slopes that are read with them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hw.calibration.measurement import LineReader, Measurement
from hw.calibration.reference_lines import Setup
from hw.emulator.emulated_camera import NOISE_40_DB, CameraImperfections, seen_by
from render.scene import Scene
from tests.hw.calibration.toy import BENDS, toy_images

MATERIAL = np.array([1.0, 0.01, 0.26, 0.1])
FIBERS = [1, 6, 11, 17]
Images = NDArray[np.float32]


@pytest.fixture(scope="module")
def images(scene: Scene) -> Images:
    """Return light of some fibers, ``(bend, fiber, row, column)``, 200 counts at most."""
    drawn = toy_images(scene, MATERIAL, 600, 360)[:, FIBERS]
    return (200 * drawn / drawn.max(axis=(2, 3), keepdims=True)).astype(np.float32)


@pytest.fixture(scope="module")
def reader(scene: Scene) -> LineReader:
    return LineReader(Setup(scene, np.full(20, np.pi / 2), BENDS), NOISE_40_DB)


def lines(
    scene: Scene, reader: LineReader, images: Images, imperfections: CameraImperfections
) -> list[Measurement]:
    rng = np.random.default_rng(0)
    found = []
    for bend, own in enumerate(images):
        for fiber, photo in zip(FIBERS, seen_by(scene, own, imperfections), strict=True):
            noisy = photo + imperfections.noise * rng.standard_normal(photo.shape)
            found.append(reader.read(np.repeat(noisy[..., None], 3, axis=2), fiber, bend))
    return found


@pytest.fixture(scope="module")
def straight(scene: Scene, reader: LineReader, images: Images) -> list[Measurement]:
    return lines(scene, reader, images, CameraImperfections(noise=0.0))


@pytest.mark.parametrize("tilt", [(-0.0064, -0.0036, -0.0084), (0.006, 0.006, 0.002)])
def test_the_tilt_is_found_with_either_sign(
    scene: Scene,
    reader: LineReader,
    images: Images,
    straight: list[Measurement],
    tilt: tuple[float, float, float],
) -> None:
    slopes, moved = [], []
    for one, two in zip(
        straight, lines(scene, reader, images, CameraImperfections(tilt=tilt)), strict=True
    ):
        used = one.used & two.used
        slopes.append(two.tilt_slope[:, used, 0].T)
        moved.append(one.counts[used, 0] - two.counts[used, 0])
    found = np.linalg.lstsq(np.concatenate(slopes), np.concatenate(moved), rcond=None)[0]
    np.testing.assert_allclose(found, tilt, atol=7e-4)


def test_lines_far_from_the_outline_of_the_pad_are_read(straight: list[Measurement]) -> None:
    for one in straight:
        assert one.used.sum() > 50
        assert np.isfinite(one.counts[one.used]).all()
        assert np.isfinite(one.tilt_slope).all()
