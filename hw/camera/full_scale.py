"""The camera's full scale, which is not its file's: stated, or found from the photographs.

Twelve bits in a file of sixteen end at 4095, floats may end at 1. Where light was cut off, many
pixels have the very same largest value, wherever that lies.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hw.camera.photo_file import Photo, Pixels
from hw.errors import CaptureError
from render.arrays import Array

FULL_SCALE = 255.0
"""Counts of the camera's full scale, in everything that follows."""
SATURATED_COUNTS = 250.0
"""Counts from which a pixel is called over-exposed: demosaicing blurs the very top."""
MAX_OVEREXPOSED_FRACTION = 0.002
"""Part of over-exposed pixels from which a photograph is refused."""
SCALES = (255.0, 1023.0, 4095.0, 16383.0, 65535.0)
"""Full scales of cameras of 8 to 16 bits."""
OVERSHOOT = 1.05
"""Factor by which floats may exceed the full scale: what scaled a picture has sharpened it."""
PILE_WIDTH, PILE_LEVELS = 0.02, 4
"""Of the largest value, and in steps: the values below it that a pile outnumbers."""
LEAST_PILE = 230
"""Of 8 bits: video ends at 235, and flat drawings do not count as over-exposed."""


def full_scale(photos: Mapping[Path, Photo], stated: float | None = None) -> float:
    """Return the value in ``photos`` of one camera that is its full scale.

    Without a ``stated`` one it is that of 8 bits, or that of all sixteen where values come in steps
    of several, or the smallest one that no value exceeds.

    Raises:
        CaptureError: a value lies above it.
    """
    largest = {path: float(photo.pixels.max()) for path, photo in photos.items()}
    path = max(largest, key=lambda one: largest[one])
    most = largest[path]
    kinds = {photo.pixels.dtype for photo in photos.values()}
    scales: tuple[float, ...] = SCALES if stated is None else (stated,)
    factor = 1.0
    if stated is None and np.dtype(np.uint8) in kinds:
        scales = SCALES[:1]
    elif stated is None and kinds == {np.dtype(np.uint16)}:
        scales = SCALES[-1:] if _step(photos) > 1 else SCALES
    elif kinds - {np.dtype(np.uint16)}:
        factor = OVERSHOOT
        scales = (1.0, *SCALES) if stated is None else scales
    fitting = [scale for scale in scales if most <= factor * scale]
    if not fitting:
        raise CaptureError(
            f"{path} has values up to {most:g}, allowed: at most {max(scales):g}, the full scale; "
            "give the value at which the camera saturates with --full-scale",
            field="full_scale",
        )
    return fitting[0]


def _step(photos: Mapping[Path, Photo]) -> int:
    """Return the largest number that divides all values: 1, but of bits that were moved up."""
    found = 0
    for photo in photos.values():
        found = int(np.gcd.reduce(photo.pixels.ravel(), initial=found))
        if found == 1:
            break
    return found


def check_exposure(photos: Mapping[Path, Photo], scale: float) -> None:
    """Refuse over-exposed ``photos`` of one camera with such a full ``scale``.

    Raises:
        CaptureError: names the first one, and what to do.
    """
    ends = np.max([photo.pixels.max(axis=(0, 1)) for photo in photos.values()], axis=0)
    for path, photo in photos.items():
        check_saturation(photo.pixels, path, scale)
        for channel in np.flatnonzero(ends > 0.5 * ends.max()).tolist():
            pile = _pile(photo.pixels[..., channel], ends[channel])
            _refuse(pile, f"{path} is over-exposed, cut off at {ends[channel]:g}, in")


def _pile(values: Pixels, end: float) -> NDArray[np.bool_]:
    """Return where ``values`` ``(row, column)`` are cut off at ``end``: nowhere unless they pile.

    Above the end of an unbroken distribution lies more than just below it, cut off into one value.
    """
    end = float(end)  # steps below 0 wrap round in the pixels' own type
    at_end = values == end
    below = (1 - PILE_WIDTH) * end
    if values.dtype.kind == "u":
        below = min(below, end - PILE_LEVELS)
    piled = np.count_nonzero(at_end) > np.count_nonzero((values >= below) & ~at_end)
    # A drawing of one value alone is not cut off.
    likely = not at_end.all() and (values.dtype != np.uint8 or end >= LEAST_PILE)
    return at_end if piled and likely else np.zeros(at_end.shape, dtype=np.bool_)


def check_saturation(pixels: Pixels, name: object, scale: float = FULL_SCALE) -> None:
    """Refuse a photograph ``(row, column, channel)`` with too many pixels at its full ``scale``.

    Raises:
        CaptureError: names their part, and what to do.
    """
    over = np.any(pixels >= scale * (SATURATED_COUNTS / FULL_SCALE), axis=2)
    _refuse(np.asarray(over), f"{name} is over-exposed in")


def _refuse(over: NDArray[np.bool_], what: str) -> None:
    part = float(over.mean())
    if part > MAX_OVEREXPOSED_FRACTION:
        raise CaptureError(
            f"{what} {100 * part:.1f} % of its pixels, allowed: at most "
            f"{100 * MAX_OVEREXPOSED_FRACTION:g} %; lower the exposure or the power",
            field="capture",
        )


def in_counts(photo: Photo, scale: float) -> Array:
    """Return counts ``(row, column, channel)``, 0 to `FULL_SCALE`."""
    return np.asarray(photo.pixels.astype(np.float64) * (FULL_SCALE / scale))
