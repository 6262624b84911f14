"""Light that does not add up is noticed, and its cause named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hw.camera.linearity import linearity
from hw.camera.photo_set import DARK_FRAMES, PhotoSet
from hw.errors import CalibrationError
from render.arrays import Array


def sweep(
    gamma: float = 1.0, noise: float = 0.0, exposure: float = 1.0, bright: float = 180.0
) -> PhotoSet:
    """Return 8 fibers' photographs and one of all, as such a camera takes them."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:96, 0:64] / 64.0
    light = np.stack(
        [np.exp(-4 * ((x - a) ** 2 + (y - b) ** 2)) for a in (0.0, 1.0) for b in (0, 0.4, 0.8, 1.2)]
    )[..., None] * np.ones(3)
    light *= bright / light.sum(axis=0).max()

    def photo(part: Array, frames: int = 1) -> Array:
        noisy = part + noise * rng.standard_normal((frames, *part.shape)).mean(axis=0)
        encoded = np.sign(noisy) * 255 * (np.abs(noisy) / 255) ** (1 / gamma)
        return np.asarray(np.clip(np.rint(encoded + 8), 0, 255))

    dark = photo(0 * light[0], DARK_FRAMES)
    alone = {fiber: photo(part) - dark for fiber, part in enumerate(light)}
    return PhotoSet(alone, photo(exposure * light.sum(axis=0)) - dark)


@pytest.mark.parametrize("noise", [0.0, 2.55])
def test_a_linear_camera_passes(noise: float) -> None:
    found = linearity(sweep(noise=noise), noise=noise)
    found.require()
    assert found.cause == "none"
    assert found.residual < 0.02


@pytest.mark.parametrize("gamma", [0.8, 1.3, 2.2])
def test_a_gamma_is_named(gamma: float) -> None:
    found = linearity(sweep(gamma=gamma), noise=0.0)
    assert found.cause == "gamma"
    assert found.gamma == pytest.approx(gamma, rel=0.1)
    with pytest.raises(CalibrationError, match="--gamma"):
        found.require()


def test_automatic_exposure_is_named() -> None:
    found = linearity(sweep(exposure=0.6), noise=0.0)
    assert found.cause == "exposure"
    assert found.exposure == pytest.approx(0.6, abs=0.02)
    with pytest.raises(CalibrationError, match="automatic exposure"):
        found.require()


def test_clipping_is_named() -> None:
    found = linearity(sweep(bright=400.0))
    assert found.cause == "clipping"
    with pytest.raises(CalibrationError, match="clipped"):
        found.require()


def test_darkness_is_refused() -> None:
    with pytest.raises(CalibrationError, match="raise the exposure"):
        linearity(sweep(bright=5.0))


def test_compression_is_named_where_it_explains_the_residual() -> None:
    photos = sweep(exposure=0.97)
    linearity(replace(photos, compression=np.zeros(3)), noise=0.0)
    lossy = linearity(replace(photos, compression=np.full(3, 1.5)), noise=0.0)
    assert lossy.cause == "compression"
    with pytest.raises(CalibrationError, match="save them as PNG"):
        lossy.require()
    # What compression cannot explain keeps its own name.
    coded = linearity(replace(sweep(gamma=2.2), compression=np.full(3, 1.5)), noise=0.0)
    assert coded.cause == "gamma"
