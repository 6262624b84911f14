"""The response matrix: how strongly each LED color reaches each channel of the camera.

Sweeps with one LED color each hold, fiber by fiber, the same light; only LED and channel differ.
So the sums of their counts over the pad are the matrix, but for one factor: what a color adds to a
channel is power * response[color, channel] * light (`render.scene.colors`). It holds the LEDs'
relative strengths, the camera's filters and the skin's color in one. Where the skin has an albedo
for each channel, its color is known from the fit, and taken out.

Its error is that of a mean over fibers, by the jackknife (Efron 1982, eq. 3.3): LEDs of one color
differ from fiber to fiber.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hw.calibration.measurement import Measurement
from hw.calibration.rig_fit import Calibration
from hw.camera.photo_set import PhotoSet
from hw.camera.projection import pad_positions
from hw.errors import CalibrationError
from optimize.ui.console import counted
from render.arrays import Array
from render.scene import Scene

MIN_FIBERS = 2
MIN_COUNTS = 1.0
"""Mean counts over the pad, in the channel that sees most of it, from which a color is bright
enough."""


@dataclass(frozen=True, eq=False)
class Response:
    """What was measured: ``matrix`` and its standard ``error``, ``(color, channel)``.

    The largest value is 1, with an error of 0; none is below 0. ``of_skin`` ``(channel,)`` is the
    relative error beside that where the skin's color was taken out, of a factor: it may be large.
    """

    matrix: Array
    error: Array
    of_skin: Array = field(default_factory=lambda: np.zeros(1))

    def interval(self, standard_errors: float) -> Array:
        """Return the ends ``(color, channel, 2)`` so many standard errors away, none below 0."""
        half, factor = standard_errors * self.error, np.exp(standard_errors * self.of_skin)
        low, high = (self.matrix - half) / factor, (self.matrix + half) * factor
        return np.stack([np.maximum(low, 0.0), high], axis=-1)


SKIN_ERROR = 0.02
"""Relative error of how bright one albedo is drawn over another: on `digit`, previews and renders
of 0.7 and 0.3 differed by 0.7 to 1.6 %."""


@dataclass(frozen=True, eq=False)
class SkinColor:
    """How bright the skin is in each channel.

    ``light`` ``(channel,)`` is that of the channel over the mean of all, ``error`` its relative
    standard error.
    """

    light: Array
    error: Array


def skin_color(found: Calibration, measurements: list[Measurement]) -> SkinColor:
    """Return the color of the skin as the fit knows it.

    Counts are gain times light, so light is known as well as gains are.
    """
    flat = [
        np.nanmean(np.where(one.used[:, None], predicted / found.gain, np.nan), axis=0)
        for one, predicted in zip(measurements, found.predicted, strict=True)
        if one.bend == 0
    ]
    light = np.mean(flat, axis=0)
    return SkinColor(light / light.mean(), np.hypot(found.errors.gain, SKIN_ERROR))


def measured_response(
    scene: Scene, sweeps: Sequence[PhotoSet], skin: SkinColor | None = None
) -> Response:
    """Return the response from one sweep for each LED color, in their order, on the flat pad.

    The color of the ``skin`` is taken out where it is known.

    Raises:
        CalibrationError: too few fibers were photographed in all colors, or a color is too dark.
    """
    rows, columns, names = scene.camera.rows, scene.camera.columns, scene.palette.names
    shown = np.isfinite(pad_positions(scene, 0.0, rows, columns)[..., 0])
    common = sorted(set.intersection(*(set(sweep.alone) for sweep in sweeps)))
    if len(common) < MIN_FIBERS:
        raise CalibrationError(
            f"{counted(len(common), 'fiber was', 'fibers were')} photographed in all of "
            f"{', '.join(names)}, allowed: at least {MIN_FIBERS}; capture the same sweep with "
            "--color of each",
            field="response",
        )
    # (fiber, color, channel)
    counts = np.array([[sweep.alone[fiber][shown].mean(axis=0) for sweep in sweeps]
                       for fiber in common])  # fmt: skip
    own = counts.mean(axis=0)[range(len(names)), scene.palette.matrix.argmax(axis=1)]
    if own.min() < MIN_COUNTS:
        color = int(np.argmin(own))
        raise CalibrationError(
            f"{names[color]} light alone gives {own[color]:.2f} counts on average over the "
            f"pad, allowed: at least {MIN_COUNTS:g}; see that the sweep was lit in that color, or "
            "raise the exposure of all sweeps",
            field="response",
        )
    counts = counts if skin is None else counts / skin.light
    total, count = counts.sum(axis=0), len(common)
    brightest = np.unravel_index(np.argmax(total), total.shape)

    def relative(sums: Array) -> Array:
        return np.asarray(sums / sums[..., *brightest, None, None])

    left_out = relative(total - counts)
    spread = ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)
    matrix, error = np.maximum(relative(total), 0.0), np.sqrt((count - 1) / count * spread)
    if skin is None:
        return Response(matrix, error)
    # Channels are known relative to that of the largest value, which is 1.
    of_skin = np.hypot(skin.error, skin.error[brightest[1]])
    of_skin[brightest[1]] = 0.0
    return Response(matrix, error, of_skin)
