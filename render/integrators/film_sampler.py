"""A picture as a path sampler: the film position is two primary dimensions."""

from __future__ import annotations

from copy import copy

import drjit as dr
import mitsuba as mi
import numpy as np

from render.integrators.connections import PROJECTION_WEIGHT, Partners, connect_subpaths
from render.integrators.emitters import Emission, EmittedRay
from render.integrators.film import PixelFilter
from render.integrators.medium_boxes import MediumBoxes, refuse_undeclared_media
from render.integrators.mirror_connections import MirrorSet
from render.integrators.subpaths import (
    PathLimits,
    SubpathStart,
    SubpathTracer,
)
from render.integrators.supported_content import refuse_unsupported
from render.integrators.vertex_cache import LaneGroups, LightVertexCache
from render.paths.vertex import channel_mean
from render.sampling.proposals import Splat
from render.sampling.streams import Numbers, Stream

CAMERA_STORED = 16
LIGHT_STORED = 24
SHARED_VERTICES, UNSHARED_VERTICES = 2, 6
"""Vertices that every light subpath keeps for connections, where lanes share them or do not."""


class FilmSampler:
    """All pixels of one sensor (``render.sampling.proposals``). Bins are pixels, row by row."""

    stored = (CAMERA_STORED, 1, LIGHT_STORED)

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor, limits: PathLimits) -> None:
        """Prepare the scene's emitters.

        Raises:
            RenderError: an emitter, sensor or medium that the sampler does not support.
        """
        refuse_unsupported(scene, sensor)
        self.scene, self.sensor, self.limits = scene, sensor, limits
        self.groups: LaneGroups | None = None
        self.lit = False  # whether light is known to arrive anywhere
        self.emission = Emission(scene, sensor)
        refuse_undeclared_media(scene, sensor, self.emission)
        self.boxes = MediumBoxes(scene, sensor)
        self.tracer = SubpathTracer(scene, sensor, self.emission, limits, MirrorSet.of(scene))
        self.filter = PixelFilter(sensor.film())
        self.width, self.height = self.filter.width, self.filter.height
        self.bins = self.width * self.height
        self.channels = len(mi.Spectrum(0.0))
        # The middle of the view: places near a camera far from the origin are not known well.
        self.ahead = mi.Float(0.5 * (sensor.far_clip() - sensor.near_clip()))
        dr.make_opaque(self.ahead)
        self.medium = mi.MediumPtr(sensor.get_medium()) if sensor.get_medium() else None

    def evaluate(self, camera: Stream, light: Stream) -> list[Splat]:
        """Return two splats per lane: at the chosen pixel, and where light met the film.

        Raises:
            RenderError: all emitters are off.
        """
        lanes = dr.width(camera.event(mi.UInt32(0))[0])
        shared = self.groups is not None
        groups = self.groups or LaneGroups(lanes, lanes, 1)
        slots = SHARED_VERTICES if shared else UNSHARED_VERTICES
        projection_weight = PROJECTION_WEIGHT if shared else 1.0
        # ------------------------------ Both subpaths ---------------------------------
        dr.eval(camera, light)  # by one kernel
        number = dr.arange(mi.UInt32, 2 * lanes)
        of_light = number >= groups.lanes
        lane = number - dr.select(of_light, groups.lanes, 0)
        stream = camera.of_lanes(lane).unless(of_light, light.of_lanes(lane))
        start, filtered = self._start(stream, of_light, lane, projection_weight)
        place = start.place
        dr.schedule(place, filtered)
        # In memory, each camera subpath can look at light subpaths of other lanes.
        radiance, kept = self.tracer.trace(start, stream, slots)
        # ------------------------------ Connections -----------------------------------
        cache = LightVertexCache(kept, slots, groups)
        self.lit = self.lit or bool(np.array(cache.represented).any())
        if not self.lit:
            self.emission.refuse_dark()
        aperture = dr.gather(mi.Point2f, place, groups.lane + groups.lanes)
        # Camera subpaths come first; those lanes are loaded, which is less than being gathered.
        radiance, place, filtered = (
            dr.reshape(x, lanes, shrink=True) for x in (radiance, place, filtered)
        )
        partners = Partners(self.tracer, kept, cache, light, self.boxes, shared, aperture)
        connected, projected, where = connect_subpaths(partners)
        # A film position has density 1, a pixel the probability 1 / bins.
        radiance += connected
        place *= mi.Vector2f(self.width, self.height)
        filtered = self.filter.pixels([place, where], [filtered.x, filtered.y])
        return [
            Splat(pixel, [value * self.bins * weight for value in light])
            for (pixel, weight), light in zip(filtered, (radiance, projected), strict=True)
        ]

    def _start(
        self, stream: Stream, of_light: mi.Bool, lane: mi.UInt32, projection_weight: float
    ) -> tuple[SubpathStart, mi.Point2f]:
        """Return where subpaths begin, and two numbers for the film's filter.

        Light vertices that are connected to the camera count ``projection_weight`` times as much
        as other connections.
        """
        numbers, further = stream.events(mi.UInt32(0), mi.UInt32(1))
        # Not by a branch: Dr.Jit (1.5) has no place for a literal that is the same on both sides.
        start: SubpathStart = dr.select(
            of_light,
            self._light_start(numbers, further),
            self._camera_start(lane, numbers, further, projection_weight),
        )
        start.of_light = of_light
        return start, mi.Point2f(numbers[2], numbers[3])

    def _light_start(self, numbers: Numbers, further: Numbers) -> SubpathStart:
        """Return where light subpaths begin."""
        pick, x, y, free = numbers
        u, w, *lens = further
        ray = self.emission.start(pick, mi.Point2f(x, y), u, w)
        infinity = mi.Float(dr.inf)
        return SubpathStart(mi.Bool(True), ray, mi.Float(0.0), infinity, mi.Point2f(*lens), free)

    def _camera_start(
        self, lane: mi.UInt32, numbers: Numbers, further: Numbers, projection_weight: float
    ) -> SubpathStart:
        """Return where camera subpaths begin."""
        place = mi.Point2f(numbers[0], numbers[1])
        if self.groups is not None:
            place = self.groups.film_positions(lane, numbers)
        free, *lens = further[:3]
        aperture = mi.Point2f(*lens)
        ray, beta = self.sensor.sample_ray(mi.Float(0.0), mi.Float(0.5), place, aperture)
        ahead = dr.zeros(mi.Interaction3f)
        ahead.p = ray(self.ahead)
        seen, importance = self.sensor.sample_direction(ahead, aperture)
        # Mitsuba's rays begin at the near plane; densities count from the place on the lens. At
        # unit distance the importance is the density of the ray per solid angle.
        near = dr.norm(ray.o - seen.p)
        density = channel_mean(importance) * dr.squared_norm(ahead.p - seen.p)
        # Georgiev 2012, eqs. 31 and 32: from the strategy that connects to the camera.
        medium = dr.zeros(mi.MediumPtr) if self.medium is None else self.medium
        begun = EmittedRay(
            mi.Point3f(ray.o), mi.Vector3f(ray.d), mi.Spectrum(beta),
            projection_weight * dr.rcp(density), mi.Float(0.0), medium, mi.Bool(False),
        )  # fmt: skip
        return SubpathStart(mi.Bool(False), begun, near, near + ray.maxt, place, free)

    def sharing(self, lanes: int, groups: int, paths: int) -> FilmSampler:
        """Return this sampler for plain Monte Carlo, whose lanes share as in ``LaneGroups``."""
        other = copy(self)
        other.groups = LaneGroups(lanes, groups, paths, self.height)
        return other
