"""A camera that renders: what a rig with unknown true parameters would photograph.

The true scene's material, fiber directions and powers are known to nobody else; so are the camera's
gains, vignetting and tilt. Images come from the preview with random numbers of their own,
or from renders that are handed in.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hw.camera.photo_set import FULL_SCALE
from hw.camera.projection import remapped, rotation
from hw.emulator.emulated_board import EmulatedBoard
from optimize.mounting import leds_per_fiber, pulse_rates, pulsed_light
from render.arrays import Array
from render.geometry import lens_directions, lens_positions
from render.scene import RGB
from tactilux import Scene

NOISE_40_DB = FULL_SCALE / 100
"""Counts of noise 40 dB below full scale."""


@dataclass(frozen=True)
class CameraImperfections:
    """What stands between the light and the photograph.

    Arguments:
        noise: standard deviation of one pixel in counts.
        black: counts of no light, which keep noise from being cut at 0.
        vignetting: part of light lost at the image's corners, growing with the square of the
            distance from its middle.
        tilt: rad, rotations of the camera about its x, y and viewing axes.
        gain: ``(channel,)`` relative sensitivity of the channels.
        leak: ``(color, channel)`` part of each LED color that each channel sees beside what it is
            said to.
        seen: ``(color, channel)`` what channels are said to see of each LED color.
    """

    noise: float = NOISE_40_DB
    black: float = 8.0
    vignetting: float = 0.0
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gain: tuple[float, ...] = (1.0, 1.0, 1.0)
    leak: tuple[tuple[float, ...], ...] = ((0.0,) * 3,) * 3
    seen: tuple[tuple[float, ...], ...] = RGB.response

    @property
    def response(self) -> Array:
        """What each LED color adds to each channel, ``(color, channel)``, relative."""
        return np.asarray((np.array(self.seen) + np.array(self.leak)) * self.gain)


@dataclass(eq=False)
class EmulatedCamera:
    """A camera that looks at the fibers that the board lights.

    ``images`` ``(fiber, row, column[, channel])`` are true radiance per unit power at any size,
    ``exposure`` counts per unit radiance, ``power`` ``(fiber,)`` or ``(fiber, color)`` the
    true strength of each fiber, which LED ``i`` of the board feeds, or as many LEDs as it takes.

    LEDs of parts that dim by pulses do so here, each by a clock of its own, where the scene's
    camera says its exposure time; rows of a camera with a line time are exposed in turn.
    """

    scene: Scene
    images: NDArray[np.float32]
    board: EmulatedBoard
    exposure: float
    power: Array
    imperfections: CameraImperfections = field(default_factory=CameraImperfections)
    seed: int = 0

    def __post_init__(self) -> None:
        """Bring the images to the camera's size, as it is tilted."""
        self._rng = np.random.default_rng(self.seed)
        known = self.scene.camera.exposure_time is not None
        self._rates = pulse_rates(self.scene) * known
        self._seen = seen_by(self.scene, self.images, self.imperfections)

    def capture(self, frames: int = 1) -> Array:
        """Return the mean of ``frames`` photographs, counts ``(row, column, channel)``."""
        power = np.atleast_2d(self.power.T).T
        fibers, colors = len(self.images), len(self.imperfections.seen)
        each = leds_per_fiber(colors)
        levels = self.board.levels[: fibers * each].reshape(fibers, 3 * each)[:, :colors]
        lit = levels / 255.0 * power
        on = np.nonzero(lit.any(axis=1))[0]
        pulses = self._rates * ((levels > 0) & (levels < 255))
        total = np.zeros(1)
        for frame in range(frames):
            if frame == 0 or pulses.any():
                light = self._light(self._lit_rows(lit, levels / 255.0, pulses)[:, on], on)
            noisy = light + self.imperfections.noise * self._rng.standard_normal(light.shape)
            total = total + np.clip(np.rint(noisy), 0.0, FULL_SCALE)
        return np.asarray(total / frames)

    def _light(self, lit: Array, on: NDArray[np.intp]) -> Array:
        """Return counts of the fibers ``on`` with powers ``lit`` ``(row, fiber, color)``."""
        axes = "fyx,yfc->yxc" if self._seen.ndim == 3 else "fyxc,yfc->yxc"
        power = lit @ self.imperfections.response
        light = np.einsum(axes, self.exposure * self._seen[on], power, optimize=True)
        return np.asarray(light + self.imperfections.black)

    def _lit_rows(self, lit: Array, duty: Array, pulses: Array) -> Array:
        """Return the power of every LED while each row is exposed, ``(row, fiber, color)``.

        ``lit`` ``(fiber, color)`` is their mean; ``pulses`` (Hz) says how often an LED comes on,
        beginning anywhere in a period; 0 where it is steady.
        """
        camera = self.scene.camera
        rows = np.repeat(lit[None], camera.rows, axis=0)
        starts = 1e-6 * (camera.line_time or 0.0) * np.arange(camera.rows)
        for fiber, color in np.argwhere(pulses).tolist():
            hertz = pulses[fiber, color]
            begin = self._rng.random() + starts * hertz
            periods = 1e-3 * (camera.exposure_time or 0.0) * hertz
            rows[:, fiber, color] *= pulsed_light(duty[fiber, color], begin, periods)
        return rows

    def close(self) -> None:
        """Do nothing: there is no camera to give back."""


def seen_by(scene: Scene, images: NDArray[np.float32], imperfections: CameraImperfections) -> Array:
    """Return ``images`` at the camera's size, tilted and vignetted.

    They are ``(fiber, row, column)``, or with one more axis ``channel``.
    """
    rows, columns = scene.camera.rows, scene.camera.columns
    turn = rotation(imperfections.tilt)
    row, column = np.meshgrid(np.arange(rows) + 0.5, np.arange(columns) + 0.5, indexing="ij")
    # From a pixel of the tilted camera to one of the small, straight image.
    look = lens_directions(scene, columns, rows, column, row) @ turn.T
    where = lens_positions(scene, images.shape[2], images.shape[1], look) - 0.5
    x, y = where[..., 0].astype(np.float32), where[..., 1].astype(np.float32)
    shade = vignette(rows, columns, imperfections.vignetting)
    shade = shade if images.ndim == 3 else shade[..., None]
    return np.stack(
        [
            # What a tilted camera sees beyond the straight image goes on as it ends.
            remapped(image, x, y, replicate=True) * shade
            for image in images
        ]
    )


def vignette(rows: int, columns: int, lost: float) -> Array:
    """Return the part of light that is kept, ``(row, column)``: 1 - lost at the corners."""
    y = (np.arange(rows) + 0.5) / rows * 2 - 1
    x = ((np.arange(columns) + 0.5) / columns * 2 - 1) * columns / rows
    square = y[:, None] ** 2 + x[None] ** 2
    return np.asarray(1 - lost * square / (1 + (columns / rows) ** 2))
