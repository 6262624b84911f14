"""An equidistant fisheye as a Mitsuba sensor: the image is the angle from the axis, theta."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi


class FisheyeCamera(mi.Sensor):
    """``fisheye``: ``fov`` degrees over all rows, square pixels; ``to_world`` as of perspective.

    For ``path`` and ``volpath``: rays begin at the camera. Light subpaths cannot be joined to it.
    """

    def __init__(self, props: Any) -> None:
        """Read the parameters."""
        mi.Sensor.__init__(self, props)
        width, height = (int(side) for side in self.film().size())
        half = 0.5 * float(dr.deg2rad(props["fov"]))
        self.half = mi.Vector2f(half * width / height, half)
        self.size = mi.Vector2f(width, height)

    def sample_ray(
        self, time: mi.Float, _wavelength: mi.Float, position: mi.Point2f, _aperture: mi.Point2f,
        _active: mi.Bool = True,
    ) -> tuple[mi.Ray3f, mi.Color3f]:  # fmt: skip
        """Return the ray through ``position`` in [0, 1]^2 of the crop, with weight 1."""
        film = self.film()
        pixel = position * mi.Vector2f(film.crop_size()) + mi.Vector2f(film.crop_offset())
        side = self.half * (1.0 - 2.0 * pixel / self.size)
        angle = dr.maximum(dr.norm(side), 1e-9)
        sine, cosine = dr.sincos(angle)
        look = mi.Vector3f(side.x * sine / angle, side.y * sine / angle, cosine)
        ray = dr.zeros(mi.Ray3f, dr.width(position))
        ray.o = self.world_transform() @ mi.Point3f(0.0)
        ray.d = dr.normalize(self.world_transform() @ look)
        ray.maxt, ray.time = dr.largest(mi.Float), time
        return ray, mi.Spectrum(1.0)

    def sample_ray_differential(
        self, time: mi.Float, wavelength: mi.Float, position: mi.Point2f, aperture: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.RayDifferential3f, mi.Color3f]:  # fmt: skip
        """Return the same ray, without differentials."""
        ray, weight = self.sample_ray(time, wavelength, position, aperture, active)
        return mi.RayDifferential3f(ray), weight

    def to_string(self) -> str:
        """Return the name."""
        return "FisheyeCamera[]"
