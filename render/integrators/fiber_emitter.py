"""The ``fiber`` emitter: a Mitsuba area light with the Gaussian profile of an optical fiber.

Attach it to a disk (or any shape) whose normal is the beam's axis::

    {'type': 'disk', 'to_world': ..., 'emitter': {'type': 'fiber', 'sigma_v': 15.0, 'power': 1.0}}

Parameters: ``sigma_v`` in degrees; either ``power`` (total, default 1) or ``radiance`` (on axis).
Profile: thesis 3.3.1, see ``render.optics.fiber_profile``. It works with every Mitsuba
integrator.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from render.errors import RenderError
from render.optics.fiber_profile import (
    angle,
    falloff,
    peak_radiance,
    sample_direction,
    truncated_mass,
)
from render.optics.fiber_profile import density as profile_density


class FiberEmitter(mi.Emitter):
    """An emitting surface with ``L(theta) = L_max exp(-(theta / (2 sigma_v))^2)``."""

    def __init__(self, props: Any) -> None:
        """Read the parameters; the peak follows from the shape's area unless it is given."""
        mi.Emitter.__init__(self, props)
        degrees = float(props.get("sigma_v", 15.0))
        if not 0.1 <= degrees <= 89.0:
            raise RenderError(
                f"sigma_v = {degrees:g} deg, allowed: 0.1 to 89 deg", field="sigma_v", value=degrees
            )
        self.sigma_v = degrees * dr.pi / 180
        self.power = float(props.get("power", 1.0))
        given: Any = props.get("radiance", None)
        self.given = None if given is None else float(given)
        for name, value in (("power", self.power), ("radiance", self.given)):
            if value is not None and not 0.0 <= value < float("inf"):
                raise RenderError(
                    f"{name} = {value:g}, allowed: finite and at least 0", field=name, value=value
                )
        self.norm = truncated_mass(self.sigma_v)
        self._peak: float | None = None
        self.m_flags = mi.EmitterFlags.Surface

    @property
    def peak(self) -> float:
        """On-axis radiance; known once the shape, and so its area, is attached."""
        if self._peak is None:
            area: Any = dr.slice(self.get_shape().surface_area())
            given = self.given
            self._peak = (
                self.power * peak_radiance(self.sigma_v, float(area)) if given is None else given
            )
        return self._peak

    def _radiance(self, local: Any) -> Any:
        return mi.Spectrum(self.peak * falloff(angle(local), self.sigma_v))

    def eval(self, si: Any, active: Any = True) -> Any:
        """Return the radiance towards ``si.wi``."""
        return dr.select(active, self._radiance(si.wi), 0.0)

    def sample_position(self, time: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Sample a point of the shape uniformly; the weight is the inverse density."""
        ps = self.get_shape().sample_position(time, sample, active)
        weight = dr.select(active & (ps.pdf > 0), dr.rcp(ps.pdf), 0.0)
        return ps, weight

    def pdf_position(self, ps: Any, active: Any = True) -> Any:
        """Return the density per area of ``sample_position``."""
        return self.get_shape().pdf_position(ps, active)

    def sample_ray(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
    ) -> tuple[Any, Any]:
        """Sample a ray with density close to its power."""
        ps, weight = self.sample_position(time, sample2, active)
        local = sample_direction(sample3.x, sample3.y, self.sigma_v, self.norm)
        theta = angle(local)
        pdf = profile_density(theta, self.sigma_v, self.norm)
        value = self.peak * falloff(theta, self.sigma_v) * local.z
        weight *= dr.select(pdf > 0, value / pdf, 0.0)
        # A surface interaction moves the origin off the shape.
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.p, si.n, si.time = ps.p, ps.n, time
        return si.spawn_ray(mi.Frame3f(ps.n).to_world(local)), mi.Spectrum(weight)

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Sample a point of the shape, uniformly, as seen from ``it``."""
        ps, _ = self.sample_position(it.time, sample, active)
        ds: Any = mi.DirectionSample3f(ps)
        ds.d = ds.p - it.p
        squared = dr.squared_norm(ds.d)
        ds.dist = dr.sqrt(squared)
        ds.d /= ds.dist
        cosine = -dr.dot(ds.d, ds.n)
        ds.pdf = dr.select(active & (cosine > 0), ps.pdf * squared / cosine, 0.0)
        ds.emitter = mi.EmitterPtr(self)
        value = self.eval_direction(it, ds, active)
        return ds, dr.select(ds.pdf > 0, value / ds.pdf, 0.0)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """Return the density per solid angle of ``sample_direction``."""
        cosine = -dr.dot(ds.d, ds.n)
        area = self.get_shape().surface_area()
        return dr.select(active & (cosine > 0), dr.square(ds.dist) / (cosine * area), 0.0)

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """Return the radiance from the point ``ds`` towards ``it``."""
        local = mi.Frame3f(ds.n).to_local(-ds.d)
        return dr.select(active & (local.z > 0), self._radiance(local), 0.0)

    def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Return no wavelengths: the emitter is gray, for mono and rgb variants."""
        return mi.Color0f(), self.eval(si, active)

    def bbox(self) -> Any:
        """Return the bounds of the shape."""
        return self.get_shape().bbox()

    def traverse(self, callback: Any) -> None:
        """Expose no differentiable parameters."""

    def to_string(self) -> str:
        """Describe the emitter."""
        return f"FiberEmitter[sigma_v = {self.sigma_v:g} rad, peak radiance = {self.peak:g}]"
