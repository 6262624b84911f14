"""Depth of what is pressed in, read from pictures as people read it: taught, tared, integrated.

The preview draws the skin with caps of balls pressed in everywhere, as people press a ball at many
places (Johnson and Adelson 2009; Wang et al. 2021). Their pixels teach a *sensor* reader the
normals of the indenter's cone. It reads another picture pixel by pixel; what it reads of the
untouched pad is taken off, and the rest is integrated (`depth`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from optimize.design import Array, Design
from optimize.readers.camera_model import CameraModel
from optimize.readers.depth import SeenGrid
from optimize.readers.normals import steepest
from optimize.readers.sensor_reader import SensorReader
from render.errors import SceneError
from render.geometry import HeightMap, Imprint, declared_sites, imprint_depth
from render.geometry.height_map import SMOOTHING, map_lines
from render.progress import Clock, OnProgress
from render.scene import Scene

if TYPE_CHECKING:
    from render.preview import Preview

CAP_PITCH = 2.3
"""Distance of taught caps in units of their radius; skin between them is taught as untouched."""
PLACE_DEGREE = 4
"""Of the reader's polynomial in place: over all that is seen, light varies more than over the
sites, for which degree 2 does. On finger20 it takes normals of caps from 3.8 to 3.1 deg."""
LESSONS = 50_000
"""Pixels, at most, from which a reader learns."""
UNTOUCHED_FRAMES = 16
"""Pictures of the untouched pad whose mean reading is taken off."""
FRAMES = 4
"""Pictures of a pressed pad, each with noise of its own, behind every figure."""
FALSE_PEAKS = 100
"""Pictures of the untouched pad whose highest points are those of nothing."""
FALSE_ALARMS = 0.01
"""Fraction of them that lie above what counts as detected."""
BALL_RADIUS = 1.0
"""Radius in mm of the ball that is looked for."""
HEIGHTS = tuple(0.001 * 2.0**step for step in range(8))
"""Depths in mm of that ball; the last is about the deepest within a cone of 30 deg."""


@dataclass(frozen=True)
class ExposedDesign:
    """A design at its own exposure: ``factor`` and ``gain`` are those of `ExposedColors`."""

    design: Design
    factor: float
    gain: float


@dataclass(frozen=True, eq=False)
class DepthReading:
    """What a design makes of one press into the flat pad.

    Arguments:
        light: the design, at its own exposure.
        depth_rms_um: error of the depth in micrometers, where skin is pressed in.
        depth_worst_um: largest error in micrometers, there and in the field of the sites.
        detected_um: smallest depth in micrometers of a ball of 2 mm that is detected: the highest
            point in the field, in the median, is above those of 99 % of pictures of the untouched
            pad. None where the last of `HEIGHTS` is not.
        clipped: fraction of the pixels on pressed skin that were read as steeper than the indenter,
            and taken for as steep as that.
        true: depth, ``(row, column)`` mm on `map_lines`; NaN where not seen.
        recovered: that of one picture, likewise.
        picture: what the camera records of it, counts ``(row, column, channel)``, the tip up.
    """

    light: ExposedDesign
    depth_rms_um: float
    depth_worst_um: float
    detected_um: float | None
    clipped: float
    true: Array
    recovered: Array
    picture: Array

    def to_json(self) -> dict[str, Any]:
        """Return the figures."""
        names = "depth_rms_um", "depth_worst_um", "detected_um", "clipped"
        figures = {name: getattr(self, name) for name in names}
        return figures | {"exposure_factor": self.light.factor, "gain": self.light.gain}


def check_flat(scene: Scene) -> None:
    """Refuse a skin that is curved or has states.

    Raises:
        SceneError: it is.
    """
    if scene.states is not None or scene.skin is not None:
        kind = "states" if scene.states is not None else "a curved skin"
        raise SceneError(
            f"{scene.name} has {kind}, allowed where depth is read: a flat one", field="press"
        )


class PressedPad:
    """Pictures of one flat pad under several lights, each at its own exposure.

    ``field`` ``(row, column)`` on `map_lines` is where the sites are, and half their spacing around
    them: what designs are judged by.
    """

    def __init__(self, scene: Scene, lights: Sequence[ExposedDesign], exposure: float) -> None:
        """Lay out the grid of depths; ``exposure`` of the scene is counts per unit of radiance.

        Raises:
            SceneError: the skin is curved, or has states.
        """
        check_flat(scene)
        self.scene, self.lights, self.exposure = scene, lights, exposure
        self.size = scene.camera.columns, scene.camera.rows
        self.half = np.array([scene.pad.width, scene.pad.length]) / 2
        self.x, self.y = map_lines(scene)
        self.grid = SeenGrid.of(scene, self.x, self.y, self.size)
        sites, room = declared_sites(scene)[:, :2], scene.sites.spacing / 2
        self.middle = sites.mean(axis=0)
        (low_x, low_y), (high_x, high_y) = sites.min(axis=0) - room, sites.max(axis=0) + room
        within_y = ((self.y >= low_y) & (self.y <= high_y))[:, None]
        self.field = self.grid.seen & within_y & (self.x >= low_x) & (self.x <= high_x)

    def pictures(self, skin: Imprint | HeightMap) -> list[Array]:
        """Return counts ``(row, column, channel)`` of each light, not clipped, the tip up."""
        from render.preview import Preview

        with Preview(self.scene, imprint=skin) as preview:
            return self._drawn(preview, pressed=True)

    def lesson(self) -> Lesson:
        """Return pictures that teach: caps of balls everywhere on what is seen.

        A cap is as wide as the indenter and as steep at its rim; its normals are even over the
        cone's disk.
        """
        from render.preview import Preview

        radius, slope = self.scene.indenter.radius, self.scene.indenter.slope
        seen = self.grid.seen
        places = [
            _places(line[held], radius)
            for line, held in ((self.x, seen.any(axis=0)), (self.y, seen.any(axis=1)))
        ]
        ball = radius / np.sin(slope)
        centers = np.stack(np.meshgrid(*places), axis=-1).reshape(-1, 2)
        skin = self.caps(centers, ball, ball * (1.0 - np.cos(slope)))
        with Preview(self.scene, imprint=skin) as preview:
            pressed, untouched = (self._drawn(preview, state) for state in (True, False))
            lesson, plain = (preview.sight(0.0, *self.size, state) for state in (True, False))
        return Lesson(
            pressed,
            untouched,
            self._image(plain.pixel, plain.position[:, :2]) / self.half,
            self._image(lesson.pixel, lesson.facing[:, :2]),
            self._image(plain.pixel, np.ones((len(plain.pixel), 1)))[..., 0] > 0.0,
        )

    def caps(self, centers: Array, radius: float, depth: float) -> HeightMap:
        """Return the skin with balls of ``radius`` mm pressed in ``depth`` mm at ``(n, 2)`` mm."""
        deep = np.zeros((len(self.y), len(self.x)))
        for x, y in centers:
            aside = (self.x - x) ** 2 + (self.y[:, None] - y) ** 2
            cap = np.sqrt(np.maximum(radius**2 - aside, 0.0)) - (radius - depth)
            deep = np.maximum(deep, cap)
        return HeightMap(deep, self.scene.pad.width, self.scene.pad.length)

    def small_ball(self, depth: float) -> HeightMap:
        """Return the skin with the ball that is looked for, ``depth`` mm deep amid the sites."""
        # On a point of the map, so that it is as deep as it should be.
        nearest = [
            line[np.abs(line - at).argmin()]
            for line, at in zip((self.x, self.y), self.middle, strict=True)
        ]
        return self.caps(np.array([nearest]), BALL_RADIUS, depth).smoothed(SMOOTHING)

    def _drawn(self, preview: Preview, pressed: bool) -> list[Array]:
        return [
            (self.exposure * light.factor)
            * preview.picture(
                light.design.phi, light.design.power, 0.0, *self.size, indented=pressed
            ).astype(np.float64)
            for light in self.lights
        ]

    def _image(self, pixel: NDArray[np.int64], values: Array) -> Array:
        """Return ``values`` ``(seen, n)`` of a `Sight` as a picture, 0 elsewhere."""
        columns, rows = self.size
        image = np.zeros((rows * columns, values.shape[1]))
        image[pixel] = values
        return image.reshape(rows, columns, -1)[::-1]


def _places(line: Array, radius: float) -> Array:
    """Return where caps are along a line of places: as many as fit, in the middle."""
    pitch, room = CAP_PITCH * radius, line[-1] - line[0] - 2.0 * radius
    count = int(max(room, 0.0) // pitch) + 1
    return np.asarray(0.5 * (line[0] + line[-1]) + pitch * (np.arange(count) - 0.5 * (count - 1)))


@dataclass(frozen=True, eq=False)
class Lesson:
    """Pictures with known normals, ``(row, column, ...)`` with the tip up.

    Arguments:
        pressed, untouched: counts of each light, not clipped.
        place: of the untouched skin that a pixel sees, as `site_places`.
        plane: the pressed skin's normals' parts along x and y.
        on: whether a pixel sees the pad.
    """

    pressed: list[Array]
    untouched: list[Array]
    place: Array
    plane: Array
    on: NDArray[np.bool_]


class PressReader:
    """One light's reader, taught and tared; all draw the same noise."""

    def __init__(
        self, pad: PressedPad, lesson: Lesson, number: int, camera: CameraModel, seed: int
    ) -> None:
        """Teach it the ``lesson`` under the light of this ``number``."""
        self._camera, self._gain = camera, pad.lights[number].gain
        self._grid, self._field = pad.grid, pad.field
        self._on, self._steepest = lesson.on, steepest(pad.scene)
        self._rng = np.random.default_rng([seed, 51])
        self._untouched = lesson.untouched[number]
        known = lesson.on & (np.linalg.norm(lesson.plane, axis=-1) <= self._steepest)
        taught = np.flatnonzero(known)
        if len(taught) > LESSONS:
            taught = self._rng.choice(taught, LESSONS, replace=False)
        counts, place, plane = (
            part.reshape(-1, part.shape[-1])[taught]
            for part in (lesson.pressed[number], lesson.place, lesson.plane)
        )
        reader = SensorReader.fit(self.recorded(counts), place, plane, PLACE_DEGREE)
        self._reader = reader.at(lesson.place[lesson.on])
        frames = (self._read(self.recorded(self._untouched)) for _ in range(UNTOUCHED_FRAMES))
        self._tare = np.mean(list(frames), axis=0)

    def recorded(self, counts: Array) -> Array:
        """Return what the camera records of ``counts``, any shape."""
        return self._camera.recorded(counts, self._rng, self._gain)

    def slopes(self, recorded: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return what pixels read, and which read steeper than the indenter and are cut to it.

        Derivatives of the depth along x and y, ``(2, row, column)``, 0 beside the pad.
        """
        plane = self._read(recorded) - self._tare
        tilt = np.linalg.norm(plane, axis=-1)
        steep = tilt > self._steepest
        plane[steep] *= (self._steepest / tilt[steep])[:, None]
        found, cut = np.zeros((2, *self._on.shape)), np.zeros(self._on.shape, dtype=bool)
        found[:, self._on] = -(plane / np.sqrt(1.0 - (plane**2).sum(axis=-1, keepdims=True))).T
        cut[self._on] = steep
        return found, cut

    def depth(self, slopes: Array) -> Array:
        """Return the depth ``(row, column)`` in mm of `slopes`, NaN where the pad is not seen."""
        return np.where(self._grid.seen, self._grid.depth(slopes), np.nan)

    def peaks(self, counts: Array, frames: int) -> Array:
        """Return the highest depth in mm in the field, in each of so many pictures of the same."""
        pictures = (self.slopes(self.recorded(counts))[0] for _ in range(frames))
        depths = (self._grid.along_sight(slopes, steps=1) for slopes in pictures)
        return np.array([depth[self._field].max() for depth in depths])

    def false_peak(self) -> float:
        """Return what peaks of the untouched pad stay below, but for `FALSE_ALARMS`, mm."""
        return float(np.quantile(self.peaks(self._untouched, FALSE_PEAKS), 1.0 - FALSE_ALARMS))

    def _read(self, recorded: Array) -> Array:
        return self._reader.plane(recorded[self._on])


def read_press(
    scene: Scene,
    press: Imprint | HeightMap,
    lights: Sequence[ExposedDesign],
    exposure: float,
    camera: CameraModel,
    seed: int,
    progress: OnProgress | None = None,
) -> list[DepthReading]:
    """Return what each design makes of ``press``; all are shown the same skins.

    Arguments:
        scene: the sensor.
        press: what is pressed in.
        lights: the designs.
        exposure: of the scene, counts per unit of radiance.
        camera: its noise.
        seed: of the noise.
        progress: told how much is done.

    Raises:
        SceneError: the skin is curved, or has states.
        GraphicsError: nothing here can draw the scene.
    """
    pad = PressedPad(scene, lights, exposure)
    clock = Clock(2 + 2 * len(lights), progress)
    lesson, pictures = pad.lesson(), pad.pictures(press)
    clock.tick(2)
    true = imprint_depth(press, pad.x[None, :], pad.y[:, None], scene.pad.thickness)
    x, y = np.moveaxis(lesson.place * pad.half, -1, 0)
    touched = lesson.on & (imprint_depth(press, x, y, scene.pad.thickness) > 0.0)
    balls: dict[float, list[Array]] = {}
    found = []
    for number, counts in enumerate(pictures):
        reader = PressReader(pad, lesson, number, camera, seed)
        frames = [reader.recorded(counts) for _ in range(FRAMES)]
        slopes, cut = zip(*(reader.slopes(frame) for frame in frames), strict=True)
        depths = np.stack([reader.depth(each) for each in slopes])
        clock.tick()
        error, judged = 1000.0 * (depths - true), pad.field | (true > 0.0)

        def peak(depth: float, reader: PressReader = reader, number: int = number) -> float:
            if depth not in balls:
                balls[depth] = pad.pictures(pad.small_ball(depth))
            return float(np.median(reader.peaks(balls[depth][number], FRAMES)))

        found.append(
            DepthReading(
                light=lights[number],
                depth_rms_um=float(np.sqrt(np.nanmean(error[:, true > 0.0] ** 2))),
                depth_worst_um=float(np.nanmax(np.abs(error[:, judged]))),
                detected_um=detected(peak, reader.false_peak()),
                clipped=float(np.mean([one[touched].mean() for one in cut])),
                true=np.where(pad.grid.seen, true, np.nan),
                recovered=depths[0],
                picture=frames[0],
            )
        )
        clock.tick()
    return found


def detected(peak: Callable[[float], float], false: float) -> float | None:
    """Return the smallest depth in micrometers whose ``peak`` is above ``false``, both in mm.

    It is sought by bisection of `HEIGHTS`, and interpolated between the last two; the first
    of them stands for what is less. None where the last is not.
    """
    peaks: dict[int, float] = {}
    low, high = -1, len(HEIGHTS)
    while high - low > 1:
        middle = (low + high) // 2
        peaks[middle] = peak(HEIGHTS[middle])
        low, high = (low, middle) if peaks[middle] > false else (middle, high)
    if high == len(HEIGHTS):
        return None
    if low < 0:
        return 1000.0 * HEIGHTS[0]
    part = (false - peaks[low]) / (peaks[high] - peaks[low])
    return 1000.0 * (HEIGHTS[low] + part * (HEIGHTS[high] - HEIGHTS[low]))
