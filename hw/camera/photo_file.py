"""One file of a photograph: upright pixels as the camera counted them, and what its form lost.

The forms are a positive list: a file whose error is not known is refused by name. JPEG says by
its quantization tables what it lost (ITU-T T.81, A.3.4), and that is handed on as noise.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hw.camera.opencv_camera import MAX_TINT_COUNTS, tint_counts
from hw.errors import CaptureError
from render.arrays import Array
from render.files import read_bytes

Pixels = NDArray[Any]

MAX_PIXELS = 64_000_000
FORMS = ("PNG", "TIFF", "JPEG", "MPO")
"""What Pillow calls the forms that are read; telephones call their JPEG files MPO."""
LOSSLESS_TIFF = (
    "raw",
    "tiff_lzw",
    "tiff_adobe_deflate",
    "tiff_deflate",
    "packbits",
    "zstd",
    "lzma",
)
ORIENTATION = 274
"""Number of the EXIF tag that says how a picture is turned."""
TURNS: dict[int, Callable[[Pixels], Pixels]] = {
    2: lambda p: p[:, ::-1],
    3: lambda p: p[::-1, ::-1],
    4: lambda p: p[::-1],
    5: lambda p: p.swapaxes(0, 1),
    6: lambda p: np.rot90(p, -1),
    7: lambda p: np.rot90(p, 2).swapaxes(0, 1),
    8: np.rot90,
}
"""What makes a picture of each such tag upright; others are as they are."""
RGB_OF_YCC = np.array([[1.0, 0.0, 1.402], [1.0, -0.344136, -0.714136], [1.0, 1.772, 0.0]])
"""Red, green and blue from luma and the two differences of color (ITU-T T.871, 7)."""
MAX_COMPRESSION = 3.5
"""Counts that a form may have lost. Down to JPEG of quality 20, off by 3.2 counts, faults of an
emulated rig were named right; at 10, off by 5.9, a healthy one was called faulty."""
BLOCK = 8
"""Pixels along a block of JPEG; its first coefficient is so many times the block's mean."""


@dataclass(frozen=True, eq=False)
class Photo:
    """What a file holds.

    Arguments:
        pixels: ``(row, column, channel)`` of uint8, uint16 or floats, in the file's own scale.
        compression: ``(channel,)`` standard deviation of what the form lost, in the same scale;
            averages over a smooth place keep it.
    """

    pixels: Pixels
    compression: Array = field(default_factory=lambda: np.zeros(1))


def read_photo(path: Path, channels: int = 3) -> Photo:
    """Return the photograph in a PNG, TIFF or JPEG picture, or in an ``.npy`` array.

    Pictures have one channel (gray, 8 or 16 bits) or three (red, green, blue), arrays of uint8,
    uint16 or floats any number. A gamma is not undone here; an opaque alpha channel is dropped, and
    a turn that EXIF tells is made.

    Raises:
        CaptureError: unreadable, of another form, not of so many ``channels``, or not finite.
    """
    try:
        content = read_bytes(path)
        array = path.suffix.lower() == ".npy"
        photo = Photo(_array(content)) if array else _picture(content, channels)
    except IsADirectoryError:
        raise _unreadable(path, "it is a directory") from None
    except OSError as error:
        raise _unreadable(path, error.strerror or "it is not an image") from None
    except (ValueError, EOFError, SyntaxError, MemoryError) as error:
        raise _unreadable(path, str(error) or "it is not an image") from None
    pixels = photo.pixels
    if pixels.ndim == 2 and channels == 1:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or pixels.shape[2] != channels or 0 in pixels.shape:
        raise CaptureError(
            f"{path} has shape {pixels.shape}, allowed: (rows, columns, {channels}), the channels "
            "of the scene's camera; capture with that camera",
            field="capture",
        )
    if (lost := float(photo.compression.max())) > MAX_COMPRESSION:
        raise CaptureError(
            f"{path} is compressed with a loss of {lost:.1f} counts, allowed: at most "
            f"{MAX_COMPRESSION:g}; save it as PNG or TIFF, or as JPEG of higher quality",
            field="capture",
        )
    if not np.isfinite(pixels).all():
        raise CaptureError(
            f"{path} holds values that are not finite: capture it again", field="capture"
        )
    return Photo(pixels, photo.compression)


def _unreadable(path: Path, reason: str) -> CaptureError:
    return CaptureError(
        f"{path} cannot be read as a photograph ({reason}): give a PNG, JPEG or TIFF picture, or "
        "an .npy array",
        field="capture",
    )


def _array(content: bytes) -> Pixels:
    found: Pixels = np.load(io.BytesIO(content), allow_pickle=False)
    if found.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
        raise ValueError(f"its type is {found.dtype}, not uint8, uint16 or float")
    return found


def _picture(content: bytes, channels: int) -> Photo:
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = MAX_PIXELS
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        try:
            with Image.open(io.BytesIO(content)) as image:
                _check_form(image, channels)
                pixels = _upright(image, content)
                lost = compression_error(image)
        except (Image.DecompressionBombWarning, Image.DecompressionBombError):
            raise ValueError("it is too large") from None
    if channels == 1 and pixels.ndim == 3:
        if (tint := tint_counts(pixels)) > MAX_TINT_COUNTS * (257 if pixels.itemsize > 1 else 1):
            raise ValueError(
                f"it has colors, channels that differ by {tint:.0f} counts, where the scene's "
                "camera sees gray"
            )
        return Photo(pixels.mean(axis=-1, keepdims=True), lost.max(keepdims=True))
    return Photo(pixels, lost)


def _check_form(image: Any, channels: int) -> None:
    """Raise ValueError of a picture whose form has lost what nobody knows, or has other channels.

    ``image`` is Pillow's, not yet decoded.
    """
    if channels not in (1, 3):
        raise ValueError(f"the scene's camera has {channels} channels, which .npy files alone have")
    if image.format not in FORMS:
        raise ValueError(f"its form is {image.format}, of which nobody knows what it lost")
    packed = image.info.get("compression", "raw")
    if image.format == "TIFF" and packed not in LOSSLESS_TIFF:
        raise ValueError(f"it is a TIFF with {packed} inside, of which nobody knows what it lost")
    # The further pictures of a telephone's file are previews of the first.
    if image.format != "MPO" and getattr(image, "n_frames", 1) > 1:
        raise ValueError(f"it holds {image.n_frames} pictures, not one")
    gray = ("L", "LA", "I;16", "I;16B", "I;16L") if channels == 1 else ()
    if image.mode == "P":
        raise ValueError("it has a palette of at most 256 colors, which is not what a camera saw")
    if image.mode not in ("RGB", "RGBA", *gray):
        raise ValueError(f"its mode is {image.mode}, not {'gray' if channels == 1 else 'RGB'}")


def _upright(image: Any, content: bytes) -> Pixels:
    """Return the pixels of Pillow's ``image``, with all bits that ``content`` has."""
    # Of 16 bits in each of several channels Pillow drops eight without a word.
    decoded = image.mode in ("RGB", "RGBA") and any(";16" in str(tile) for tile in image.tile)
    if decoded:
        import cv2

        pixels = np.asarray(
            cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        )
        if pixels.ndim == 3:
            # OpenCV's channels are blue, green, red.
            pixels = np.concatenate([pixels[..., 2::-1], pixels[..., 3:]], axis=-1)
    else:
        # Decoding turns a TIFF, and strikes out its tag.
        image.load()
        pixels = np.asarray(image)
        pixels = pixels.astype(np.uint16) if pixels.itemsize == 2 else pixels
    if image.mode in ("RGBA", "LA"):
        # A cut-out or an overlay: its colors are not those that the camera saw.
        if (pixels[..., -1] != np.iinfo(pixels.dtype).max).any():
            raise ValueError("it is transparent in places")
        pixels = pixels[..., 0] if image.mode == "LA" else pixels[..., :-1]
    # OpenCV has turned a TIFF already.
    turned = decoded and image.format == "TIFF"
    turn = None if turned else TURNS.get(image.getexif().get(ORIENTATION, 1))
    return pixels if turn is None else turn(pixels)


def compression_error(image: Any) -> Array:
    """Return the error ``(channel,)`` that Pillow's ``image`` has where it is smooth, in counts.

    A block's mean is quantized in steps of the first entry of its table over `BLOCK`, and luma and
    differences of color in whole counts: two uniform errors each. Where light is smooth, neighbors
    share them, so averages keep them. On an emulated rig 0.3 (quality 100) to 0.7 (quality 50) of
    it was measured: light that changes over a spot takes some of it away.
    """
    tables = getattr(image, "quantization", None)
    if not tables:
        return np.zeros(1)
    steps = np.array([tables[component[3]][0] for component in image.layer]) / BLOCK
    variance = (1 + steps**2) / 12
    ycc = RGB_OF_YCC if len(steps) == 3 else np.ones((1, 1))
    return np.asarray(np.sqrt(ycc**2 @ variance))
