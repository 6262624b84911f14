"""The camera's full scale is found from what its photographs hold, whatever holds them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hw.camera.full_scale import check_exposure, full_scale, in_counts
from hw.camera.photo_file import Photo, Pixels
from hw.errors import CaptureError
from render.arrays import Array

NAME = Path("fiber-00.npy")


def light(peak: float) -> Array:
    """Return a noisy spot of light, ``peak`` of the full scale at most."""
    y, x = np.mgrid[-1:1:120j, -1:1:80j]
    spot = peak * np.exp(-2 * (x**2 + y**2))[..., None] * [1.0, 0.5, 0.05] + 0.03
    return np.asarray(spot + 0.004 * np.random.default_rng(0).standard_normal(spot.shape))


def stored(peak: float, bits: int = 8, form: str = "right") -> Pixels:
    """Return that light as a camera of so many bits gives it."""
    levels = np.clip(np.rint(light(peak) * (2**bits - 1)), 0, 2**bits - 1)
    if form == "left":
        return (levels.astype(np.uint16)) << (16 - bits)
    if form == "unit":
        return np.asarray(levels / (2**bits - 1))
    if form == "float":
        return np.asarray(levels, dtype=np.float32)
    return levels.astype(np.uint8 if bits == 8 else np.uint16)


FORMS = [
    (8, "right"), (10, "right"), (12, "right"), (14, "right"), (16, "right"), (10, "left"),
    (12, "left"), (14, "left"), (8, "unit"), (12, "unit"), (8, "float"), (12, "float"),
]  # fmt: skip


@pytest.mark.parametrize(("bits", "form"), FORMS)
def test_the_same_light_has_the_same_counts_in_all_forms(bits: int, form: str) -> None:
    photos = {NAME: Photo(stored(0.8, bits, form))}
    scale = full_scale(photos)
    check_exposure(photos, scale)
    np.testing.assert_allclose(in_counts(photos[NAME], scale), 255 * light(0.8), atol=1.0)


@pytest.mark.parametrize(("bits", "form"), FORMS)
def test_light_that_was_cut_off_is_refused_in_all_forms(bits: int, form: str) -> None:
    photos = {NAME: Photo(stored(1.4, bits, form))}
    with pytest.raises(CaptureError, match=r"fiber-00.npy is over-exposed.* % of its pixels"):
        check_exposure(photos, full_scale(photos))


@pytest.mark.parametrize("kind", [np.uint16, np.float64])
@pytest.mark.parametrize("end", [0.94, 0.61, 0.2])
def test_light_is_seen_to_be_cut_off_wherever_its_end_lies(
    kind: type[np.generic], end: float
) -> None:
    # A black level that was taken off, a limit of the program, another gain in each channel.
    cut = np.minimum(light(1.4) * [1.0, 1.7, 3.0], 1.0) * end
    pixels = np.maximum(65535 * cut, 0.0).astype(kind)
    with pytest.raises(CaptureError, match=f"over-exposed, cut off at {pixels.max():g}, in"):
        check_exposure({NAME: Photo(pixels)}, 65535.0)


def test_video_ends_below_its_full_scale() -> None:
    video = np.clip(np.rint(16 + 219 * light(1.4)), 16, 235).astype(np.uint8)
    with pytest.raises(CaptureError, match="cut off at 235"):
        check_exposure({NAME: Photo(video)}, 255.0)


def test_a_stated_full_scale_is_taken() -> None:
    photos = {NAME: Photo(stored(0.2, 12))}
    assert full_scale(photos) == 1023.0  # all that can be known
    assert full_scale(photos, 4095.0) == 4095.0
    with pytest.raises(
        CaptureError, match=r"values up to .*, allowed: at most 255, the full scale"
    ):
        full_scale(photos, 255.0)


def test_a_dark_photograph_has_the_full_scale_of_the_others() -> None:
    photos = {Path("dark.npy"): Photo(stored(0.0, 12)), NAME: Photo(stored(0.8, 12))}
    assert full_scale(photos) == 4095.0
    mean = {Path("dark.npy"): Photo(stored(0.0, 8).astype(np.float64)), NAME: Photo(stored(0.8))}
    assert full_scale(mean) == 255.0


def test_a_deep_photograph_among_shallow_ones_raises_one_clear_error() -> None:
    photos = {Path("dark.png"): Photo(stored(0.1, 16)), NAME: Photo(stored(0.8))}
    with pytest.raises(CaptureError, match=r"dark.png has values up to .* --full-scale"):
        full_scale(photos)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_nearly_black_photographs_are_not_over_exposed(kind: type) -> None:
    levels = np.random.default_rng(1).integers(0, 3, (60, 40, 3)).astype(kind)
    check_exposure({NAME: Photo(levels, np.zeros(3))}, 4095.0)
