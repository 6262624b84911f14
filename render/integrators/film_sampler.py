"""A picture as a sampling problem: the film position is two primary dimensions."""

from __future__ import annotations

from copy import copy
from typing import Any

import drjit as dr
import mitsuba as mi

from render.arrays import Array
from render.errors import RenderError
from render.integrators.camera_subpaths import camera_part
from render.integrators.connections import joins
from render.integrators.emitters import Emission
from render.integrators.light_subpaths import light_part, project, seen_from
from render.integrators.mirror_connections import Mirrors
from render.integrators.path_limits import PathLimits
from render.integrators.vertex_cache import Ensemble
from render.paths.vertex import PASSES
from render.sampling.proposals import Splat

CAMERA_STORED = 16
LIGHT_STORED = 24
# Vertices that every light subpath keeps for joins, where others help out and where none do.
TOGETHER, ALONE = 2, 6
# What projecting a light vertex onto the film counts for, relative to joins that help each other
# out: many light subpaths are looked at for one that is projected.
PROJECTED = 0.25


class FilmSampler:
    """All pixels of one sensor (``render.sampling.proposals``). Bins are pixels, row by row."""

    stored = (CAMERA_STORED, 1, LIGHT_STORED)

    def __init__(self, scene: Any, sensor: Any, limits: PathLimits) -> None:
        """Prepare the scene's emitters.

        Raises:
            RenderError: an emitter, sensor or medium that the sampler does not support.
        """
        if sensor.class_name() != "PerspectiveCamera":
            raise RenderError(
                f"sensor {sensor.class_name()} is not supported, allowed: perspective",
                field="sensor",
                value=sensor.class_name(),
            )
        _refuse_heterogeneous(scene, sensor)
        self.scene, self.sensor, self.limits = scene, sensor, limits
        self.ensemble: Ensemble | None = None
        self.emission = Emission(scene)
        self.mirrors = Mirrors.of(scene)
        self.width, self.height = (int(n) for n in sensor.film().crop_size())
        self.bins = self.width * self.height
        self.channels = len(mi.Spectrum(0.0))
        self.medium = mi.MediumPtr(sensor.get_medium()) if sensor.get_medium() else None

    def evaluate(self, camera: Any, light: Any) -> list[Splat]:
        """Return two deposits per lane: at the chosen pixel, and where light met the film."""
        numbers = camera.event(mi.UInt32(0))
        lanes = dr.width(numbers[0])
        position: Any = mi.Point2f(numbers[0], numbers[1])
        weight = mi.Float(1.0)
        projected = 1.0 if self.ensemble is None else PROJECTED
        if self.ensemble is not None:
            position, weight = self.ensemble.placed(numbers, self.height)
        ray, beta = self.sensor.sample_ray(mi.Float(0.0), mi.Float(0.5), position, mi.Point2f(0.5))
        # Mitsuba's rays begin at the near plane; densities count from the pinhole.
        ray.o = mi.Point3f(self.sensor.world_transform().translation())
        ray.o += dr.zeros(mi.Point3f, lanes)
        ahead = dr.zeros(mi.Interaction3f)
        ahead.p = ray.o + ray.d
        # At unit distance the importance is the density of the ray per solid angle.
        _, importance = self.sensor.sample_direction(ahead, mi.Point2f(0.5))
        medium = dr.zeros(mi.MediumPtr) if self.medium is None else self.medium
        part = camera_part(
            self.scene, self.emission, ray, medium, dr.mean(importance),
            beta + dr.zeros(mi.Spectrum, lanes), camera, self.limits, self.mirrors, projected,
        )  # fmt: skip
        found = light_part(
            self.scene, self.sensor, self.emission, light, self.limits, self.mirrors,
            ALONE if self.ensemble is None else TOGETHER,
        )  # fmt: skip
        # From memory, each camera subpath can look at light subpaths of other lanes.
        dr.eval(part, found, position, weight)
        ensemble = self.ensemble or Ensemble(lanes, lanes, 1)
        joined = joins(
            self.scene, part, found, ensemble, light, self.limits, self.mirrors,
            self.ensemble is not None,
        )  # fmt: skip
        v, share = seen_from(found.shown.vertex, mi.UInt32(PASSES)), found.shown_share
        where, splat = project(self.scene, self.sensor, v, projected, share > 0)
        splat *= share
        # A film position has density 1, a pixel the share 1 / bins.
        here = [value * weight * self.bins for value in part.radiance + joined]
        there = [value * self.bins for value in splat]
        size: Any = mi.Vector2f(self.width, self.height)
        return [Splat(self._pixel(position * size), here), Splat(self._pixel(where), there)]

    def together(
        self, lanes: int, groups: int, paths: int, density: Array | None = None
    ) -> FilmSampler:
        """Return this problem for plain Monte Carlo, with lanes as in ``Ensemble``."""
        other = copy(self)
        other.ensemble = Ensemble(lanes, groups, paths, density)
        return other

    def _pixel(self, position: Any) -> Any:
        """Return the pixel of film positions in pixels."""
        column = dr.minimum(mi.UInt32(dr.maximum(position.x, 0.0)), self.width - 1)
        row = dr.minimum(mi.UInt32(dr.maximum(position.y, 0.0)), self.height - 1)
        return row * self.width + column


def _refuse_heterogeneous(scene: Any, sensor: Any) -> None:
    media = [sensor.get_medium()]
    for shape in scene.shapes():
        media += [shape.interior_medium(), shape.exterior_medium()]
    for medium in media:
        if medium is not None and not medium.is_homogeneous():
            raise RenderError(
                f"medium {medium.id()!r} is heterogeneous, allowed: homogeneous media; "
                "use volpath for this scene",
                field="medium",
            )
