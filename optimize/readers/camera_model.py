"""The camera as a reader meets it: exposure, gain, saturation, noise and rounding."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optimize.design import Array
from render.scene import Scene
from render.scene.camera import READ_BY_CAMERA

FULL_SCALE = 255.0
"""Counts at which a channel saturates, whatever its bits."""


@dataclass(frozen=True)
class CameraModel:
    """What limits a camera; counts run from 0 to 255, and full scale holds ``full_well`` electrons.

    One standard deviation at gain g is ``sqrt((g read_noise)^2 + g count 255 / full_well)`` counts
    (read and shot noise, EMVA 1288), then counts are rounded to ``bits``. The defaults are assumed
    where a scene's ``[camera]`` does not say: they are usual for small sensors with global or
    rolling shutter.

    Several ``shots`` are equal to one picture in exposure: all have the same, and together they
    last as long as one picture would, which ends where the brightest shot's light alone would
    saturate it, or after ``longest_exposure``. So each has one n-th of the time, n times the gain,
    and is read out and rounded by itself: n shots of light that is the same in all have the shot
    noise of one picture together, and n times the variance of its read noise.

    Arguments:
        read_noise: in counts at gain 1.
        full_well: photoelectrons at 255 counts and gain 1.
        bits: of the digits.
        saturated: fraction of channels of facets and untouched pad that may reach full scale.
        longest_exposure: of all shots together, in units of the scene's own; what is darker takes
            gain.
        gains: that it has, least first; any of at least 1 unless given.
        assumed: which of these nobody has stated.
        shots: pictures that are taken one after the other.
    """

    read_noise: float = 1.0
    full_well: float = 10_000.0
    bits: int = 8
    saturated: float = 0.001
    longest_exposure: float = 4.0
    gains: tuple[float, ...] = ()
    assumed: tuple[str, ...] = READ_BY_CAMERA
    shots: int = 1

    @classmethod
    def of(cls, scene: Scene) -> CameraModel:
        """Return the camera of ``scene``, with the defaults for what its file does not say."""
        said = {key: getattr(scene.camera, key) for key in READ_BY_CAMERA}
        if said["gains"] is not None:
            said["gains"] = tuple(sorted(said["gains"]))
        return cls(shots=scene.palette.shots).stating(**said)

    def stating(self, **fields: Any) -> CameraModel:
        """Return the camera with those ``fields`` that are not None."""
        known = {name: value for name, value in fields.items() if value is not None}
        assumed = tuple(name for name in self.assumed if name not in known)
        return replace(self, **known, assumed=assumed)

    @property
    def sentence(self) -> str:
        """What degrees rest on, and which of it is assumed."""
        gains = ", ".join(f"{gain:g}" for gain in self.gains) or "as needed"
        text = (
            f"Degrees are those of a camera with {self.read_noise:g} counts of read noise, "
            f"{self.full_well:g} electrons at 255 counts, {self.bits} bits, "
            f"{self._exposures} {self.longest_exposure:g} times the scene's, gain {gains}, and "
            f"{self.saturated:.3g} of all colors at full scale"
        )
        if not self.assumed:
            return f"{text}."
        return f"{text}; assumed, as [camera] does not say it: {', '.join(self.assumed)}."

    @property
    def _exposures(self) -> str:
        if self.shots == 1:
            return "exposures of up to"
        return f"{self.shots} shots that together last as long as one picture, up to"

    @property
    def step(self) -> float:
        """Counts between two digits."""
        return FULL_SCALE / float(2**self.bits - 1)

    @property
    def shot(self) -> float:
        """Variance of shot noise per count, at gain 1."""
        return FULL_SCALE / self.full_well

    def variance(self, counts: Array, gain: Array | float = 1.0) -> Array:
        """Return the variance of noise and rounding, counts squared, 0 where ``counts`` saturate.

        ``gain`` has the shape of ``counts`` or broadcasts to it.
        """
        variance = self._noise(np.maximum(counts, 0.0), gain) + self.step**2 / 12.0
        return np.where(counts >= FULL_SCALE, 0.0, variance)

    def recorded(self, counts: Array, rng: np.random.Generator, gain: float = 1.0) -> Array:
        """Return what the camera records of ``counts`` (any shape)."""
        deviation = np.sqrt(self._noise(np.clip(counts, 0.0, FULL_SCALE), gain))
        noisy = counts + deviation * rng.standard_normal(counts.shape)
        return np.clip(np.round(noisy / self.step) * self.step, 0.0, FULL_SCALE)

    def exposed(self, counts: Array) -> tuple[Array, Array, NDArray[np.intp]]:
        """Return factor and gain of a design's own exposure, and which count decides it.

        ``counts`` ``(..., n)`` are all channels of all facets and the untouched pad at the scene's
        exposure. The exposure time of a shot is ``factor / gain`` times the scene's. All three have
        the shape ``(...)``; a design without light keeps the scene's exposure.
        """
        rank = int(np.ceil((1.0 - self.saturated) * counts.shape[-1])) - 1
        decides = np.argpartition(counts, rank, axis=-1)[..., rank]
        brightest = np.take_along_axis(counts, decides[..., None], axis=-1)[..., 0]
        lit = brightest > 0.0
        full = np.where(lit, FULL_SCALE / np.where(lit, brightest, 1.0), 1.0)
        time = np.minimum(full, self.longest_exposure) / self.shots
        factor, gain = full, full / time
        if self.gains:
            # The least that is enough; what is darker than the greatest allows stays dark.
            steps = np.array(self.gains)
            gain = steps[np.minimum(np.searchsorted(steps, gain * (1 - 1e-12)), len(steps) - 1)]
            factor = np.minimum(full, gain * time)
        return factor, gain, decides

    def _noise(self, counts: Array, gain: Array | float) -> Array:
        """Return the variance of read and shot noise."""
        return np.asarray((self.read_noise * gain) ** 2 + counts * self.shot * gain)
