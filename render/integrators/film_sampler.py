"""A picture as a path sampler: the film position is two primary dimensions."""

from __future__ import annotations

from copy import copy

import drjit as dr
import mitsuba as mi
import numpy as np

from render.integrators.connections import connect_subpaths
from render.integrators.emitters import Emission
from render.integrators.film import PixelFilter
from render.integrators.medium_boxes import MediumBoxes, refuse_undeclared_media
from render.integrators.mirror_connections import MirrorSet
from render.integrators.subpaths import (
    CameraRay,
    PathLimits,
    connect_to_camera,
    trace_camera_subpath,
    trace_light_subpath,
)
from render.integrators.supported_content import refuse_unsupported
from render.integrators.vertex_cache import LaneGroups, LightVertexCache
from render.paths.vertex import VOLUME_PASSES, channel_mean, for_camera_passes
from render.sampling.proposals import Splat
from render.sampling.streams import Stream

CAMERA_STORED = 16
LIGHT_STORED = 24
SHARED_VERTICES, UNSHARED_VERTICES = 2, 6
"""Vertices that every light subpath keeps for connections, where lanes share them or do not."""
PROJECTION_WEIGHT = 0.25
"""What connecting a light vertex to the camera counts for, relative to connections of lanes that
share vertices: many light subpaths are looked at for one that is projected."""


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
        self.emission = Emission(scene, sensor)
        refuse_undeclared_media(scene, sensor, self.emission)
        self.mirrors = MirrorSet.of(scene)
        self.boxes = MediumBoxes(scene, sensor)
        self.filter = PixelFilter(sensor.film())
        self.width, self.height = self.filter.width, self.filter.height
        self.bins = self.width * self.height
        self.channels = len(mi.Spectrum(0.0))
        # Between the clipping planes, from the near one on.
        near, far = sensor.near_clip(), sensor.far_clip()
        self.ahead = mi.Float(float(np.sqrt(near * far)) - near)
        dr.make_opaque(self.ahead)
        self.medium = mi.MediumPtr(sensor.get_medium()) if sensor.get_medium() else None

    def evaluate(self, camera: Stream, light: Stream) -> list[Splat]:
        """Return two splats per lane: at the chosen pixel, and where light met the film."""
        # ------------------------------ Ray of the camera -----------------------------
        numbers = camera.event(mi.UInt32(0))
        lanes = dr.width(numbers[0])
        position = mi.Point2f(numbers[0], numbers[1])
        shared = self.groups is not None
        projection_weight = PROJECTION_WEIGHT if shared else 1.0
        if self.groups is not None:
            position = self.groups.film_positions(numbers, self.height)
        # The first event of the walk itself uses one number.
        aperture = mi.Point2f(*camera.event(mi.UInt32(1))[1:3])
        ray, beta = self.sensor.sample_ray(mi.Float(0.0), mi.Float(0.5), position, aperture)
        ahead = dr.zeros(mi.Interaction3f)
        ahead.p = ray(self.ahead)
        seen, importance = self.sensor.sample_direction(ahead, aperture)
        # Mitsuba's rays begin at the near plane; densities count from the place on the lens. At
        # unit distance the importance is the density of the ray per solid angle.
        near = dr.norm(ray.o - seen.p)
        start = CameraRay(
            o=mi.Point3f(ray.o), d=mi.Vector3f(ray.d), near=near, far=near + ray.maxt,
            medium=dr.zeros(mi.MediumPtr) if self.medium is None else self.medium,
            density=channel_mean(importance) * dr.squared_norm(ahead.p - seen.p),
            beta=beta + dr.zeros(mi.Spectrum, lanes),
        )  # fmt: skip
        # ------------------------------ Both subpaths ---------------------------------
        camera_subpath = trace_camera_subpath(
            self.scene, self.emission, start, camera, self.limits, self.mirrors, projection_weight
        )
        light_vertices = trace_light_subpath(
            self.scene, self.sensor, self.emission, light, self.limits, self.mirrors,
            SHARED_VERTICES if shared else UNSHARED_VERTICES,
        )  # fmt: skip
        # From memory, each camera subpath can look at light subpaths of other lanes.
        dr.eval(camera_subpath, light_vertices, position)
        # ------------------------------ Connections -----------------------------------
        cache = LightVertexCache(light_vertices, self.groups or LaneGroups(lanes, lanes, 1))
        connected = connect_subpaths(
            self.scene, camera_subpath, cache, light, self.limits, self.mirrors, self.boxes, shared
        )
        v = for_camera_passes(light_vertices.projected.vertex, mi.UInt32(VOLUME_PASSES))
        projected_weight = light_vertices.projected_weight
        where, projected = connect_to_camera(
            self.scene, self.sensor, v, light_vertices.aperture, projection_weight,
            projected_weight > 0,
        )  # fmt: skip
        projected *= projected_weight
        # A film position has density 1, a pixel the probability 1 / bins.
        radiance = camera_subpath.radiance + connected
        size = mi.Vector2f(self.width, self.height)
        pixel, weight = self.filter.pixel(position * size, numbers[2])
        here = [value * self.bins * weight for value in radiance]
        other, weight = self.filter.pixel(where, numbers[3])
        there = [value * self.bins * weight for value in projected]
        return [Splat(pixel, here), Splat(other, there)]

    def sharing(self, lanes: int, groups: int, paths: int) -> FilmSampler:
        """Return this sampler for plain Monte Carlo, whose lanes share as in ``LaneGroups``."""
        other = copy(self)
        other.groups = LaneGroups(lanes, groups, paths)
        return other
