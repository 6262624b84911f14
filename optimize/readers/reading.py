"""What a design is worth: by how many degrees each reader misses normals, at its own exposure.

The score S is a stand-in for this (thesis 4.2): a good light makes normal to color one-to-one and
steep. Both readers are shown noisy colors of random normals at every site and state.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from optimize.design import Array, ReadErrors
from optimize.objectives import READERS
from optimize.readers.camera_model import CameraModel
from optimize.readers.model_colors import ModelColors, model_offsets
from optimize.readers.normal_colors import colors_of_normals
from optimize.readers.normals import angle, plane_parts, random_normals, steepest, vectors
from optimize.readers.place_reader import look_up
from optimize.readers.saturation import saturating_tilts
from optimize.readers.sensor_reader import SensorReader, site_places
from optimize.scoring import normal_factor, student_factor
from render.scene import Scene

SAMPLES = 64
"""Random normals per site and state that both readers are shown."""
LESSONS = 9000
"""Random normals, at least, from which the sensor reader learns; people record far more."""
SEEDS = 8
"""Independent draws of normals and noise behind every figure."""


@dataclass(frozen=True, eq=False)
class ExposedColors:
    """Counts of facets and, last, of the untouched pad, ``(B, S, facet + 1, C)``, not clipped.

    Arguments:
        colors: at the design's own exposure.
        factor: by which they are brighter than at the scene's exposure.
        gain: of the camera; the exposure time is ``factor / gain`` times the scene's.
    """

    colors: Array
    factor: float
    gain: float

    @classmethod
    def of(cls, colors: Array, camera: CameraModel) -> ExposedColors:
        """Return ``colors``, counts at the scene's exposure, at the exposure that suits them."""
        factor, gain, _ = camera.exposed(colors.reshape(-1))
        return cls(colors * factor, float(factor), float(gain))

    def like(self, colors: Array) -> ExposedColors:
        """Return other ``colors`` of the same design, counts at the scene's exposure."""
        return replace(self, colors=colors * self.factor)


@dataclass(frozen=True, eq=False)
class AngleErrors:
    """Angles between true and recovered normals in degrees, ``(state, site, sample)``."""

    sensor: Array
    place: Array


def read_normals(
    scene: Scene, known: ExposedColors, shown: ExposedColors, camera: CameraModel, seed: int
) -> AngleErrors:
    """Return the errors of both readers under camera noise.

    Readers learn from ``known``; the camera sees ``shown``, the same for a perfect calibration,
    with noise, also in the sensor reader's training. The same ``seed`` shows two designs the same
    normals.
    """
    shape, slope = (*known.colors.shape[:2], SAMPLES), steepest(scene)
    rng = np.random.default_rng([seed, 9])
    tilt, azimuth = random_normals(rng, shape)
    seen = camera.recorded(colors_of_normals(shown.colors, tilt, azimuth), rng, shown.gain)
    truth = vectors(plane_parts(slope, tilt, azimuth))
    lessons = (*shape[:2], max(SAMPLES, -(-LESSONS // (shape[0] * shape[1]))))
    other = random_normals(rng, lessons)
    taught = camera.recorded(colors_of_normals(known.colors, *other), rng, known.gain)
    channels, places = seen.shape[-1], site_places(scene)[:, None]
    reader = SensorReader.fit(
        taught.reshape(-1, channels),
        np.broadcast_to(places, (*lessons, 2)).reshape(-1, 2),
        plane_parts(slope, *other).reshape(-1, 2),
    )
    where = np.broadcast_to(places, (*shape, 2)).reshape(-1, 2)
    read = reader.read(seen.reshape(-1, channels), where).reshape(truth.shape)
    return AngleErrors(angle(read, truth), angle(look_up(known.colors, seen, slope), truth))


def half_width(draws: Array, offsets: Array, confidence: float = 0.95) -> float:
    """Return that of the interval of the mean of ``draws``, which ``offsets`` may move."""
    count, known = len(draws), 0.0
    if count > 1:
        scatter = float(draws.std(ddof=1)) / math.sqrt(count)
        known = student_factor(count, confidence) * scatter
    moved = math.sqrt(float(np.square(offsets).mean())) if len(offsets) else 0.0
    return math.hypot(known, normal_factor(confidence) * moved)


@dataclass(frozen=True, eq=False)
class ReaderFigures:
    """One reader's errors in degrees.

    Arguments:
        means, percentiles: over all normals, and the 95th percentile, of every draw of normals and
            noise, ``(seed,)``.
        map: means over draws and normals, ``(state, site)``.
        offsets: of the mean, where colors are off as those of a model may be, ``(draw,)``;
            none where nobody knows.
    """

    means: Array
    percentiles: Array
    map: Array
    offsets: Array = field(default_factory=lambda: np.empty(0))

    @classmethod
    def of(cls, errors: Array, offsets: Array) -> ReaderFigures:
        """Return the figures of ``errors`` ``(seed, state, site, sample)`` in degrees."""
        percentiles = np.quantile(errors, 0.95, axis=(1, 2, 3))
        return cls(errors.mean(axis=(1, 2, 3)), percentiles, errors.mean(axis=(0, 3)), offsets)

    @property
    def mean(self) -> float:
        """Over all normals and draws."""
        return float(self.means.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of `mean`: the draws', and of what a model's colors may be off by."""
        half = half_width(self.means, self.offsets)
        return self.mean - half, self.mean + half

    def to_json(self) -> dict[str, Any]:
        """Return what programs rely on, in degrees; states and sites are counted from 0."""
        state, site = np.unravel_index(int(self.map.argmax()), self.map.shape)
        return {
            "mean_deg": self.mean,
            "interval_deg": list(self.interval),
            "95%_deg": float(self.percentiles.mean()),
            "worst_deg": float(self.map.max()),
            "worst_state": int(state),
            "worst_site": int(site),
        }


@dataclass(frozen=True, eq=False)
class Reading:
    """What both readers make of a design, and the exposure at which they do.

    ``saturates`` are tilts in degrees by channel, see `saturating_tilts`.
    """

    sensor: ReaderFigures
    place: ReaderFigures
    factor: float
    gain: float
    saturates: tuple[float | None, ...] = ()

    @property
    def errors(self) -> ReadErrors:
        """The means alone, as a design's file has them."""
        means = self.sensor.mean, self.place.mean
        return ReadErrors(*means, self.factor, self.gain, self.saturates)


def reading(
    scene: Scene,
    known: Array,
    camera: CameraModel | None = None,
    seeds: Sequence[int] = range(SEEDS),
    shown: Array | None = None,
    errors: Array | None = None,
) -> Reading:
    """Return both readers' errors on ``shown``, after they learned from ``known``.

    Shown what they learned from, by the surrogate or the preview, which have no render noise, they
    tell what the light itself is worth; reports say it beside S.

    Arguments:
        scene: the sensor.
        known: counts ``(B, S, facet + 1, C)`` of facets and untouched pad at the scene's exposure,
            not clipped; their own exposure is the camera's.
        camera: noise and exposure; that of the scene unless given.
        seeds: draw normals and noise independently; the same show two designs the same.
        shown: likewise, ``known`` itself unless given.
        errors: ``(draw, ...)`` of what ``known`` may be off by; None where nobody knows.
    """
    camera = camera or CameraModel.of(scene)
    learned = ExposedColors.of(known, camera)
    true = learned if shown is None else learned.like(shown)
    found = [read_normals(scene, learned, true, camera, seed) for seed in seeds]
    offsets = {name: np.empty(0) for name in READERS}
    if errors is not None:
        offsets = model_offsets(scene, ModelColors(known[None], errors[:, None]), camera)
    figures = {
        name: ReaderFigures.of(np.stack([getattr(errors, name) for errors in found]), offsets[name])
        for name in READERS
    }
    saturates = saturating_tilts(scene, learned.colors)
    return Reading(**figures, factor=learned.factor, gain=learned.gain, saturates=saturates)
