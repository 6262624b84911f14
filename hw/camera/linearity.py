"""Is light additive in the photographs? Each fiber alone, added up, against all together.

What is wrong shows in the residual: a gamma makes the sum of many dim parts too large, the more of
them the larger; automatic exposure scales whole photographs; clipping cuts the brightest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw.camera.full_scale import FULL_SCALE, SATURATED_COUNTS
from hw.camera.photo_set import DARK_FRAMES, MAX_DARK_COUNTS, PhotoSet
from hw.errors import CalibrationError
from render.arrays import Array

MIN_COUNTS = 30.0
"""Counts of all fibers together from which a pixel is used."""
MAX_RESIDUAL = 0.02
"""Residual (rms, relative) up to which the camera counts as linear."""
CLIPPED_COUNTS = SATURATED_COUNTS - MAX_DARK_COUNTS
"""Counts above the dark frame from which a pixel counts as clipped."""
MAX_CLIPPED_FRACTION = 0.002
"""Part of clipped pixels from which clipping is what is wrong."""
GAMMAS = np.arange(0.40, 3.501, 0.02)


@dataclass(frozen=True)
class Linearity:
    """What the test found.

    Arguments:
        residual: rms of (sum - together) / together over bright pixels, noise taken out.
        clipped: part of pixels at the end of the range.
        gamma: the exponent that makes light most additive, 1 when it is; noise makes it too
            large where the camera encodes the dark.
        exposure: together over the sum of all, as if only the exposure had changed.
        cause: ``none``, ``gamma``, ``clipping``, ``exposure``, ``compression`` or ``unknown``.
    """

    residual: float
    clipped: float
    gamma: float
    exposure: float
    cause: str

    def require(self) -> None:
        """Refuse photographs that nothing should be calibrated on.

        Raises:
            CalibrationError: names the cause and what to do.
        """
        told = {
            "gamma": "the photographs look gamma-encoded: switch the camera's gamma off, or pass "
            "its value with --gamma",
            "clipping": f"{100 * self.clipped:.1f} % of the pixels are clipped: lower the exposure "
            "or the power",
            "exposure": f"all fibers together are exposed {self.exposure:.2f} times as long as "
            "each alone: switch automatic exposure and gain off",
            "compression": "their compression alone may explain it: save them as PNG, TIFF or .npy",
            "unknown": "neither gamma, clipping nor exposure explains it: keep room light away and "
            "the rig still, then capture again",
        }
        if self.cause != "none":
            raise CalibrationError(
                f"light does not add up in these photographs ({100 * self.residual:.1f} % rms, "
                f"allowed: {100 * MAX_RESIDUAL:g} %); {told[self.cause]}",
                field="linearity",
            )


def linearity(photos: PhotoSet, noise: float = 2.55) -> Linearity:
    """Return how far light is from additive in ``photos``.

    ``noise`` is the standard deviation of one pixel of one photograph, in counts.

    Raises:
        CalibrationError: no photograph of all fibers together, or no pixel is bright enough.
    """
    if photos.together is None:
        raise CalibrationError(
            "the sweep holds no photograph of all fibers together (all.png or all.npy), so the "
            "camera cannot be tested for linearity: capture one with `tactilux hw capture`",
            field="linearity",
        )
    together = _binned(photos.together)
    alone = np.stack([_binned(photo) for photo in photos.alone.values()])
    clipped = float((together >= CLIPPED_COUNTS).mean())
    used = (together > MIN_COUNTS) & (together < CLIPPED_COUNTS)
    if used.sum() < 50 and clipped <= MAX_CLIPPED_FRACTION:
        raise CalibrationError(
            "all fibers together light too few pixels to test the camera: raise the exposure",
            field="linearity",
        )
    if clipped > MAX_CLIPPED_FRACTION:
        lost = float(
            np.sqrt(np.mean((alone.sum(axis=0) / np.maximum(together, MIN_COUNTS) - 1) ** 2))
        )
        return Linearity(lost, clipped, 1.0, 1.0, "clipping")
    parts, whole = alone[:, used], together[used]
    # The dark frame is in every part, and so n - 1 times in the sum less the whole.
    count = len(parts) + 1
    part_noise = noise / BIN * np.sqrt(count + (len(parts) - 1) ** 2 / DARK_FRAMES)
    lost = float(np.max(photos.compression) * np.sqrt(count * np.mean(1 / whole**2)))

    def misfit(parts: Array, whole: Array) -> float:
        """Return the rms relative residual without what noise explains."""
        total = parts.sum(axis=0)
        square = ((total - whole) / whole) ** 2 - (part_noise / whole) ** 2
        return float(np.sqrt(max(np.mean(square), 0.0)))

    plain = misfit(parts, whole)
    exposure = float(np.median(whole / parts.sum(axis=0)))
    scaled = misfit(parts * exposure, whole)
    powers = [
        misfit(
            np.maximum(parts, 0.0) ** g * FULL_SCALE ** (1 - g), whole**g * FULL_SCALE ** (1 - g)
        )
        for g in GAMMAS
    ]
    gamma = float(GAMMAS[int(np.argmin(powers))])
    cause = "none"
    if plain > MAX_RESIDUAL and lost >= plain:
        cause = "compression"
    elif plain > MAX_RESIDUAL:
        by_cause = {"gamma": min(powers), "exposure": scaled}
        cause = min(by_cause, key=lambda name: by_cause[name])
        if by_cause[cause] > 0.5 * plain:
            cause = "unknown"
    return Linearity(plain, clipped, 1.0 if cause == "none" else gamma, exposure, cause)


BIN = 8
"""Pixels along each side that are averaged, which keeps noise from bending the powers."""


def _binned(photo: Array) -> Array:
    """Return ``(..., row, column, channel)`` averaged over squares of `BIN` pixels."""
    *front, rows, columns, channels = photo.shape
    kept = photo[..., : rows // BIN * BIN, : columns // BIN * BIN, :]
    shape = (*front, rows // BIN, BIN, columns // BIN, BIN, channels)
    return np.asarray(kept.reshape(shape).mean(axis=(-4, -2)))
