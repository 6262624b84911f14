"""Photographs in files: read as linear counts, refused when they cannot be used."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hw.errors import CaptureError
from render.arrays import Array

FULL_SCALE = 255.0
SATURATED_COUNTS = 250.0
"""Counts from which a pixel is called over-exposed: demosaicing blurs the very top."""
MAX_OVEREXPOSED_FRACTION = 0.002
"""Part of over-exposed pixels from which a photograph is refused."""
DARK_FRAMES = 32
"""Photographs that are averaged for a dark frame: its noise is in everything else."""
MAX_DARK_COUNTS = 20.0
"""Counts that a dark frame may have on average: more is room light or an LED that stays on."""
MAX_PIXELS = 64_000_000


def read_photo(path: Path) -> Array:
    """Return the photograph as counts ``(row, column, 3)``, red, green, blue, 0 to 255.

    PNG, JPEG and TIFF files, and ``.npy`` arrays of uint8, uint16 or float counts. The counts are
    as the camera gave them: a gamma is not undone here. An opaque alpha channel is dropped.

    Raises:
        CaptureError: unreadable, not a color image, or not finite.
    """
    try:
        content = path.read_bytes()
        pixels = _array(content) if path.suffix == ".npy" else _picture(content)
    except IsADirectoryError:
        raise _unreadable(path, "it is a directory") from None
    except OSError as error:
        raise _unreadable(path, error.strerror or "it is not an image") from None
    except (ValueError, EOFError, SyntaxError, MemoryError) as error:
        raise _unreadable(path, str(error) or "it is not an image") from None
    if pixels.ndim != 3 or pixels.shape[2] != 3 or 0 in pixels.shape:
        raise CaptureError(
            f"{path} has shape {pixels.shape}, allowed: (rows, columns, 3); capture in color",
            field="capture",
            value=pixels.shape,
        )
    scale = {np.dtype(np.uint8): 1.0, np.dtype(np.uint16): FULL_SCALE / 65535}.get(
        pixels.dtype, 1.0
    )
    counts = pixels.astype(np.float64) * scale
    if not np.isfinite(counts).all():
        raise CaptureError(
            f"{path} holds values that are not finite: capture it again", field="capture"
        )
    return counts


def check_photo(counts: Array, rows: int, columns: int, name: str) -> None:
    """Refuse a photograph of another size, or one that is over-exposed.

    Raises:
        CaptureError: says which, and what to do.
    """
    if counts.shape[:2] != (rows, columns):
        found_rows, found_columns = counts.shape[:2]
        raise CaptureError(
            f"{name} has {found_columns} x {found_rows} pixels, allowed: {columns} x {rows} as the "
            "scene's camera; dewarp it with --lens, or scale it (another camera in the scene is "
            "another sensor, which needs its own model)",
            field="capture",
            value=(found_columns, found_rows),
            allowed=f"{columns} x {rows}",
        )
    part = float((counts >= SATURATED_COUNTS).any(axis=2).mean())
    if part > MAX_OVEREXPOSED_FRACTION:
        raise CaptureError(
            f"{name} is over-exposed in {100 * part:.1f} % of its pixels, allowed: at most "
            f"{100 * MAX_OVEREXPOSED_FRACTION:g} %; lower the exposure or the power",
            field="capture",
            value=part,
            allowed=f"at most {MAX_OVEREXPOSED_FRACTION:g}",
        )


def linear(counts: Array, gamma: float) -> Array:
    """Return counts proportional to light from counts with ``gamma`` (1: as they are)."""
    return counts if gamma == 1.0 else FULL_SCALE * (np.maximum(counts, 0.0) / FULL_SCALE) ** gamma


def _picture(content: bytes) -> NDArray[np.uint8]:
    import warnings

    from PIL import Image

    Image.MAX_IMAGE_PIXELS = MAX_PIXELS
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        try:
            with Image.open(io.BytesIO(content)) as image:
                if image.mode not in ("RGB", "RGBA"):
                    raise ValueError(f"its mode is {image.mode}, not RGB")
                # A cut-out or an overlay: its colors are not those that the camera saw.
                if image.mode == "RGBA" and image.getchannel("A").getextrema() != (255, 255):
                    raise ValueError("it is transparent in places")
                return np.asarray(image.convert("RGB"))
        except (Image.DecompressionBombWarning, Image.DecompressionBombError):
            raise ValueError("it is too large") from None


def _array(content: bytes) -> NDArray[np.generic]:
    found: NDArray[np.generic] = np.load(io.BytesIO(content), allow_pickle=False)
    if found.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
        raise ValueError(f"its type is {found.dtype}, not uint8, uint16 or float")
    return found


def _unreadable(path: Path, reason: str) -> CaptureError:
    return CaptureError(
        f"{path} cannot be read as a photograph ({reason}): give a PNG, JPEG or .npy file",
        field="capture",
        value=str(path),
    )
