"""Emitting surfaces whose radiance depends on the angle to their normal alone.

What ``fiber`` and ``measured_light`` share as Mitsuba emitters; they work with every integrator.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from render.errors import RenderError


class ProfileEmitter(mi.Emitter):
    """An area light of radiance ``radiance(local)``, of which ``local_density`` is a likeness.

    Without a shape it is dark: Dr.Jit asks all emitters that are alive, those of other scenes too.
    """

    def __init__(self, props: Any) -> None:
        """Read ``power``, the total one."""
        mi.Emitter.__init__(self, props)
        self.power = float(props.get("power", 1.0))
        check_amount("power", self.power)
        self.m_flags = mi.EmitterFlags.Surface

    def radiance(self, local: Any) -> Any:
        """Return the radiance in directions about the normal +z; 0 behind the surface."""
        raise NotImplementedError

    def sample_local(self, u: Any, v: Any) -> Any:
        """Return unit directions about +z."""
        raise NotImplementedError

    def local_density(self, local: Any) -> Any:
        """Return the density per solid angle of ``sample_local``."""
        raise NotImplementedError

    def area(self) -> float:
        """Return the area of the shape, known once it is attached; infinite without one."""
        shape = self.get_shape()
        if shape is None:
            return math.inf
        area: Any = dr.slice(shape.surface_area())
        return float(area)

    def eval(self, si: Any, active: Any = True) -> Any:
        """Return the radiance towards ``si.wi``."""
        return dr.select(active, self.radiance(si.wi), 0.0)

    def sample_position(self, time: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Sample a point of the shape uniformly; the weight is the inverse density."""
        shape = self.get_shape()
        if shape is None:
            return dr.zeros(mi.PositionSample3f), mi.Float(0.0)
        ps = shape.sample_position(time, sample, active)
        weight = dr.select(active & (ps.pdf > 0), dr.rcp(ps.pdf), 0.0)
        return ps, weight

    def pdf_position(self, ps: Any, active: Any = True) -> Any:
        """Return the density per area of ``sample_position``."""
        shape = self.get_shape()
        return mi.Float(0.0) if shape is None else shape.pdf_position(ps, active)

    def sample_ray(
        self, time: Any, _sample1: Any, sample2: Any, sample3: Any, active: Any = True
    ) -> tuple[Any, Any]:
        """Sample a ray with density close to its power."""
        ps, weight = self.sample_position(time, sample2, active)
        local = self.sample_local(sample3.x, sample3.y)
        pdf = self.local_density(local)
        value = self.radiance(local) * local.z
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

    def pdf_direction(self, _it: Any, ds: Any, active: Any = True) -> Any:
        """Return the density per solid angle of ``sample_direction``."""
        cosine, shape = -dr.dot(ds.d, ds.n), self.get_shape()
        area = mi.Float(math.inf) if shape is None else shape.surface_area()
        return dr.select(active & (cosine > 0), dr.square(ds.dist) / (cosine * area), 0.0)

    def eval_direction(self, _it: Any, ds: Any, active: Any = True) -> Any:
        """Return the radiance from the point ``ds`` towards ``it``."""
        local = mi.Frame3f(ds.n).to_local(-ds.d)
        return dr.select(active & (local.z > 0), self.radiance(local), 0.0)

    def sample_wavelengths(self, si: Any, _sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Return no wavelengths: the emitter is gray, for mono and rgb variants."""
        return mi.Color0f(), self.eval(si, active)

    def bbox(self) -> Any:
        """Return the bounds of the shape."""
        return self.get_shape().bbox()

    def traverse(self, callback: Any) -> None:
        """Expose no differentiable parameters."""


def check_amount(name: str, value: float) -> None:
    """Raise a RenderError unless ``value`` is finite and at least 0."""
    if not 0.0 <= value < float("inf"):
        raise RenderError(f"{name} = {value:g}, allowed: finite and at least 0", field=name)
