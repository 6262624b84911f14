"""Photographs are read as they are, or refused with what to do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hw.camera.full_scale import full_scale, in_counts
from hw.camera.photo_file import read_photo
from hw.camera.photo_set import PhotoSet, check_photo, linear
from hw.errors import CaptureError

PIXELS = np.random.default_rng(0).integers(0, 256, (6, 4, 3)).astype(np.uint8)


def test_a_png_keeps_its_channels_and_rows(tmp_path: Path) -> None:
    Image.fromarray(PIXELS).save(tmp_path / "a.png")
    assert np.array_equal(read_photo(tmp_path / "a.png").pixels, PIXELS)


def test_an_opaque_alpha_channel_is_dropped(tmp_path: Path) -> None:
    opaque = np.concatenate([PIXELS, np.full_like(PIXELS[..., :1], 255)], axis=-1)
    Image.fromarray(opaque).save(tmp_path / "a.png")
    assert np.array_equal(read_photo(tmp_path / "a.png").pixels, PIXELS)
    opaque[0, 0, 3] = 254
    Image.fromarray(opaque).save(tmp_path / "a.png")
    with pytest.raises(CaptureError, match="transparent in places"):
        read_photo(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("kind", "scale"), [(np.uint8, 1.0), (np.uint16, 257.0), (np.float32, 1.0)]
)
def test_an_array_is_read_in_counts(tmp_path: Path, kind: type[np.generic], scale: float) -> None:
    np.save(tmp_path / "a.npy", (PIXELS * scale).astype(kind))
    photo = read_photo(tmp_path / "a.npy")
    full = full_scale({tmp_path / "a.npy": photo})
    np.testing.assert_allclose(in_counts(photo, full), PIXELS)


def test_gamma_is_undone() -> None:
    light = np.array([0.0, 10.0, 128.0, 255.0])
    encoded = 255 * (light / 255) ** (1 / 2.2)
    np.testing.assert_allclose(linear(encoded, 2.2), light, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.png", b"rubbish"),
        ("a.png", b""),
        ("a.npy", b"rubbish"),
        ("a.npy", b"\x93NUMPY\x01\x00"),
        ("a.jpg", b"\xff\xd8\xff\xe0"),
    ],
)
def test_rubbish_raises_one_clear_error(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CaptureError, match="give a PNG, JPEG or"):
        read_photo(tmp_path / name)


def test_a_truncated_png_raises_one_clear_error(tmp_path: Path) -> None:
    Image.fromarray(np.tile(PIXELS, (50, 50, 1))).save(tmp_path / "a.png")
    content = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(content[: len(content) // 2])
    with pytest.raises(CaptureError, match="cannot be read"):
        read_photo(tmp_path / "a.png")


def test_a_pickle_is_not_opened(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(CaptureError):
        read_photo(tmp_path / "a.npy")


def test_a_gray_photograph_is_refused(tmp_path: Path) -> None:
    Image.fromarray(PIXELS[..., 0]).save(tmp_path / "a.png")
    with pytest.raises(CaptureError, match="not RGB"):
        read_photo(tmp_path / "a.png")


def test_nan_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((6, 4, 3), np.nan))
    with pytest.raises(CaptureError, match="finite"):
        read_photo(tmp_path / "a.npy")


@pytest.mark.parametrize("path", ["none.png", "."])
def test_what_is_no_file_is_refused(tmp_path: Path, path: str) -> None:
    with pytest.raises(CaptureError, match="cannot be read"):
        read_photo(tmp_path / path)


def test_another_size_is_refused_with_the_right_one() -> None:
    with pytest.raises(CaptureError, match="4 x 6 pixels, allowed: 5 x 6"):
        check_photo(PIXELS.astype(float), 6, 5, "photo")


def test_over_exposure_is_refused() -> None:
    counts = np.full((6, 4, 3), 100.0)
    check_photo(counts, 6, 4, "photo")
    counts[0, 0, 1] = 255.0
    with pytest.raises(CaptureError, match="over-exposed"):
        check_photo(counts, 6, 4, "photo")


GRAY = PIXELS[..., :1]


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_a_gray_camera_has_gray_pictures(tmp_path: Path, kind: type[np.generic]) -> None:
    scale = 257 if kind is np.uint16 else 1
    Image.fromarray((GRAY[..., 0].astype(kind) * scale).astype(kind)).save(tmp_path / "a.png")
    found = read_photo(tmp_path / "a.png", 1).pixels
    np.testing.assert_array_equal(found, GRAY.astype(kind) * scale)


def test_a_gray_picture_with_three_channels_alike_is_gray(tmp_path: Path) -> None:
    Image.fromarray(np.repeat(GRAY, 3, axis=-1)).save(tmp_path / "a.png")
    assert np.array_equal(read_photo(tmp_path / "a.png", 1).pixels, GRAY)
    Image.fromarray(PIXELS).save(tmp_path / "a.png")
    with pytest.raises(CaptureError, match="it has colors, channels that differ by"):
        read_photo(tmp_path / "a.png", 1)


def test_arrays_have_any_number_of_channels(tmp_path: Path) -> None:
    many = np.repeat(PIXELS, 2, axis=-1)[..., :5]
    np.save(tmp_path / "a.npy", many)
    np.save(tmp_path / "b.npy", GRAY[..., 0])
    assert np.array_equal(read_photo(tmp_path / "a.npy", 5).pixels, many)
    assert np.array_equal(read_photo(tmp_path / "b.npy", 1).pixels, GRAY)
    with pytest.raises(CaptureError, match=r"shape \(6, 4, 5\), allowed: \(rows, columns, 4\)"):
        read_photo(tmp_path / "a.npy", 4)


def test_a_picture_of_a_camera_of_four_channels_raises_one_clear_error(tmp_path: Path) -> None:
    Image.fromarray(PIXELS).save(tmp_path / "a.png")
    with pytest.raises(CaptureError, match=r"4 channels, which \.npy files alone have"):
        read_photo(tmp_path / "a.png", 4)


def test_a_sweep_needs_photographs_of_the_fibers_alone_that_the_design_lights() -> None:
    sweep = PhotoSet({0: np.ones((6, 4, 3)), 2: 2 * np.ones((6, 4, 3))}, None)
    lit = np.array([True, False, True])
    assert sweep.stacked(lit, lambda photo: photo[0, 0]).tolist() == [
        [1.0] * 3,
        [0.0] * 3,
        [2.0] * 3,
    ]
    with pytest.raises(CaptureError, match=r"fiber 1 \(1 is missing\), allowed: all of 0 to 2;"):
        sweep.stacked(np.ones(3, dtype=np.bool_), lambda photo: photo)
    with pytest.raises(CaptureError, match=r"fiber 3 \(2 are .* 0 to 4 that the design lights;"):
        sweep.stacked(np.array([True, False, True, True, True]), lambda photo: photo)
