"""Pictures are read upright with all their bits, or refused for what their form has lost."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hw.camera.photo_file import ORIENTATION, compression_error, read_photo
from hw.errors import CaptureError

PIXELS = np.random.default_rng(0).integers(0, 256, (6, 4, 3)).astype(np.uint8)
TURNED = {  # tag of EXIF: what a camera held so has stored of an upright picture
    1: PIXELS,
    2: PIXELS[:, ::-1],
    3: PIXELS[::-1, ::-1],
    4: PIXELS[::-1],
    5: PIXELS.swapaxes(0, 1),
    6: np.rot90(PIXELS),
    7: np.rot90(PIXELS, 2).swapaxes(0, 1),
    8: np.rot90(PIXELS, -1),
}


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("tag", list(TURNED))
def test_a_turn_that_exif_tells_is_made(tmp_path: Path, tag: int, suffix: str) -> None:
    exif = Image.Exif()
    exif[ORIENTATION] = tag
    stored = np.ascontiguousarray(TURNED[tag])
    Image.fromarray(stored).save(tmp_path / f"a{suffix}", exif=exif)
    assert np.array_equal(read_photo(tmp_path / f"a{suffix}").pixels, PIXELS)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("bits", [10, 12, 16])
def test_no_bit_of_a_deep_picture_is_dropped(tmp_path: Path, suffix: str, bits: int) -> None:
    cv2 = pytest.importorskip("cv2")
    deep = np.random.default_rng(1).integers(0, 2**bits, (6, 4, 3)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / f"a{suffix}"), deep[..., ::-1])
    assert np.array_equal(read_photo(tmp_path / f"a{suffix}").pixels, deep)


def saved(tmp_path: Path, name: str, **options: object) -> Path:
    picture = Image.fromarray(np.tile(PIXELS, (8, 8, 1)))
    if options.pop("palette", False):
        picture = picture.quantize(256)
    picture.save(tmp_path / name, **options)  # type: ignore[arg-type]
    return tmp_path / name


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("a.png", {"palette": True}, "a palette of at most 256 colors"),
        ("a.gif", {}, "its form is GIF, of which nobody knows what it lost"),
        ("a.webp", {}, "its form is WEBP"),
        ("a.png", {"format": "WEBP", "quality": 80}, "its form is WEBP"),
        ("a.avif", {}, "its form is AVIF"),
        ("a.jp2", {}, "its form is JPEG2000"),
        ("a.tif", {"compression": "jpeg", "quality": 80}, "a TIFF with jpeg inside"),
        ("a.jpg", {"quality": 5}, "a loss of .* counts, allowed: at most 3.5; save it as PNG"),
    ],
)
def test_a_form_whose_loss_is_unknown_or_large_raises_one_clear_error(
    tmp_path: Path, name: str, options: dict[str, object], said: str
) -> None:
    with pytest.raises(CaptureError, match=said):
        read_photo(saved(tmp_path, name, **options))


def test_a_file_of_several_pictures_raises_one_clear_error(tmp_path: Path) -> None:
    pages = [Image.fromarray(PIXELS), Image.fromarray(PIXELS)]
    pages[0].save(tmp_path / "a.tif", save_all=True, append_images=pages[1:])
    with pytest.raises(CaptureError, match="it holds 2 pictures, not one"):
        read_photo(tmp_path / "a.tif")


@pytest.mark.parametrize("subsampling", [0, 2])
@pytest.mark.parametrize("quality", [30, 50, 75, 90, 95])
def test_the_error_that_a_jpeg_leaves_in_averages_is_that_of_its_steps(
    quality: int, subsampling: int
) -> None:
    rng = np.random.default_rng(0)
    # Each tile of 32 x 32 pixels has a light of its own, which hardly changes over it.
    light = np.kron(rng.uniform(10, 200, (16, 16, 3)), np.ones((32, 32, 1)))
    light = light + np.linspace(0, 0.5, 512)[:, None, None]
    noisy = np.rint(light + 1.0 * rng.standard_normal(light.shape)).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(noisy).save(stream, "JPEG", quality=quality, subsampling=subsampling)
    with Image.open(stream) as image:
        said = compression_error(image)
        off = np.asarray(image).astype(float) - noisy
    # Away from the tiles' edges, as spots are.
    means = off.reshape(16, 32, 16, 32, 3)[:, 8:24, :, 8:24].mean(axis=(1, 3))
    found = np.sqrt((means**2).mean(axis=(0, 1)))
    assert (found < 1.1 * said).all(), (found, said)
    assert (found > 0.25 * said).all(), (found, said)


def test_a_gray_jpeg_has_the_error_of_luma_alone(tmp_path: Path) -> None:
    Image.fromarray(PIXELS[..., 0]).save(tmp_path / "a.jpg", quality=50)
    photo = read_photo(tmp_path / "a.jpg", 1)
    # Its first step is 16 (Table K.1 of T.81 at quality 50), over 8.
    np.testing.assert_allclose(photo.compression, np.sqrt((1 + 2.0**2) / 12))


@pytest.mark.parametrize("suffix", [".png", ".tif", ".npy"])
def test_a_form_without_loss_has_no_error(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    if suffix == ".npy":
        np.save(path, PIXELS)
    else:
        Image.fromarray(PIXELS).save(path)
    assert not read_photo(path).compression.any()
