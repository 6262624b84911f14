"""Photographs that are turned or mirrored: named as such, before every fiber is blamed.

The light of single fibers says which way up a photograph is, whatever its colors; of one photograph
of all fibers, colors must.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hw.check.prediction import SiteSpots
from hw.errors import CaptureError
from render.arrays import Array

TURNED: dict[str, tuple[Callable[[Array], Array], str]] = {
    "upside down": (lambda p: p[::-1, ::-1], "turn them by 180 deg"),
    "mirrored left to right": (
        lambda p: p[:, ::-1],
        "mirror them back, or number the fibers the other way round",
    ),
    "mirrored top to bottom": (lambda p: p[::-1], "mirror them back"),
}
ON_ITS_SIDE: dict[str, tuple[Callable[[Array], Array], str]] = {
    "turned by 90 deg": (lambda p: np.rot90(p), "turn them back"),
    "turned by -90 deg": (lambda p: np.rot90(p, -1), "turn them back"),
    "transposed": (lambda p: p.swapaxes(0, 1), "exchange rows and columns"),
    "transposed and upside down": (
        lambda p: np.rot90(p, 2).swapaxes(0, 1),
        "exchange rows and columns, and turn them by 180 deg",
    ),
}
MIN_BETTER = 0.5
"""Part of the misfit that another way up must leave to be named."""
MIN_MISFIT = 0.05
"""Misfit from which one is named. On ``finger20`` it is 0.01 straight, with faulty fibers as well,
0.17 mirrored and 0.4 upside down; of one photograph 0.02 and 0.12 or more."""


def check_orientation(expected: Array, photos: Array, spots: SiteSpots) -> None:
    """Refuse photographs that another way up explains.

    ``expected`` ``(n, site, channel)`` is predicted light; ``photos`` ``(n, row, column, channel)``
    show it at any gain. Of several, brightness alone counts; of one, its colors do.

    Raises:
        CaptureError: names the way.
    """
    straight = _misfit(expected, np.stack([spots.colors(photo) for photo in photos]))
    if straight <= MIN_MISFIT:
        return
    ways = TURNED | (ON_ITS_SIDE if photos.shape[1] == photos.shape[2] else {})
    found = {
        name: _misfit(expected, np.stack([spots.colors(undo(photo)) for photo in photos]))
        for name, (undo, _) in ways.items()
    }
    best = min(found, key=lambda name: found[name])
    if found[best] < MIN_BETTER * straight:
        raise CaptureError(
            f"the photographs are {best}, allowed: row 0 towards the tip, columns towards -x, as "
            f"`tactilux render` draws; {ways[best][1]}",
            field="capture",
        )


def _misfit(expected: Array, seen: Array) -> float:
    """Return the median over photographs of how their shares of light differ, 0 to 1."""
    seen = np.maximum(np.nan_to_num(seen), 0.0)
    if len(expected) > 1:
        expected, seen = (colors.sum(axis=2, keepdims=True) for colors in (expected, seen))
    # Gains of channels are the camera's own.
    wanted, got = (
        colors / np.maximum(colors.sum(axis=1, keepdims=True), 1e-9) for colors in (expected, seen)
    )
    return float(np.median(0.5 * np.abs(got - wanted).sum(axis=1).mean(axis=1)))
