"""Transmittances in target weights, without a ray where a medium fills its bounding box.

A weight by which a connection is drawn may be wrong at the cost of noise. So the way through a
medium that fills the box around it, a flat layer, ends where it leaves that box: a few operations
instead of a ray cast. Media of other shapes get the ray: their boxes are mostly empty.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.errors import RenderError
from render.integrators.emitters import Emission, shape_corners
from render.paths.vertex import Vertex, channel_mean, extinction, leave
from render.sampling.streams import HashedStream

FILLED_MIN = 0.98
"""Fraction of a box that its medium fills, at least, to be taken for the box."""
PROBE_COUNT = 4096
"""Points by which that fraction is measured."""
RAY_COUNT = 64
"""Rays by which it is found in what medium the camera and each emitter are."""
CROSSED_MAX = 4
"""Surfaces that such a ray looks through, at most."""
OPTICAL_DEPTH_MAX = 4.0
"""Where optical depths in weights are cut: those are never 0."""


class MediumBoxes:
    """Extinction (1/mm, mean over channels) and box of each medium that fills its box.

    ``others`` says whether the scene has media that do not.
    """

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor) -> None:
        """Gather the media of all shapes and of the sensor."""
        self.scene = scene
        parts: dict[Any, list[Array]] = {}
        for shape in scene.shapes():
            for medium in {shape.interior_medium(), shape.exterior_medium()} - {None}:
                parts.setdefault(medium, []).append(shape_corners(shape))
        # What the camera is in has no box.
        parts.pop(sensor.get_medium(), None)
        self.others = sensor.get_medium() is not None
        self.media, self.sigma, self.low, self.high = [], [], [], []
        for medium, corners in parts.items():
            pointer, around = mi.MediumPtr(medium), np.concatenate(corners)
            low, high = around.min(axis=0), around.max(axis=0)
            if _filled_fraction(scene, pointer, low, high) < FILLED_MIN:
                self.others = True
                continue
            self.media.append(pointer)
            self.sigma.append(channel_mean(extinction(pointer, mi.Bool(True))[1]))
            self.low.append(mi.Point3f(low))
            self.high.append(mi.Point3f(high))
        # Literal numbers would be compiled into the kernels.
        dr.make_opaque(self.media, self.sigma, self.low, self.high)

    def transmittance(self, y: Vertex, p: mi.Point3f, active: mi.Bool) -> mi.Float:
        """Return the transmittance from ``y`` to the end of its medium towards ``p``, or to it.

        By the mean extinction over channels, and at least e^-4; 1 outside of media.
        """
        origin, medium = leave(y, p - y.p)
        span = p - origin
        distance = dr.norm(span)
        w = span / dr.maximum(distance, 1e-20)
        depth = mi.Float(0.0)
        rest = active & (medium != None)  # noqa: E711 (a Dr.Jit pointer array)
        inverse = dr.rcp(dr.select(w == 0.0, 1e-20, w))
        for known, sigma, low, high in zip(
            self.media, self.sigma, self.low, self.high, strict=True
        ):
            # The farther one of two parallel planes is where a ray from inside leaves.
            ends = dr.maximum((low - origin) * inverse, (high - origin) * inverse)
            within = dr.clip(dr.min(ends), 0.0, distance)
            depth = dr.select(medium == known, sigma * within, depth)
            rest &= medium != known
        if self.others:
            sigma = channel_mean(extinction(medium, rest)[1])
            ray = mi.Ray3f(mi.Ray3f(origin, w), distance)
            hit = self.scene.ray_intersect_preliminary(
                ray, coherent=False, active=rest & (sigma > 0)
            )
            end = dr.select(hit.is_valid(), hit.t, distance)
            depth = dr.select(rest, sigma * end, depth)
        return dr.exp(-dr.minimum(depth, OPTICAL_DEPTH_MAX))


def refuse_undeclared_media(scene: mi.Scene, sensor: mi.Sensor, emission: Emission) -> None:
    """Raise a RenderError for a camera or an emitter in a medium that it does not declare.

    Mitsuba's ``volpath`` looks from the camera only, and never asks in what an emitter is; light
    subpaths start there, and end at the camera.
    """
    if not emission.media:
        return
    x, y, u, v = HashedStream(dr.arange(mi.UInt32, RAY_COUNT)).event(mi.UInt32(0))
    seen, _ = sensor.sample_ray(mi.Float(0.0), mi.Float(0.5), mi.Point2f(x, y), mi.Point2f(u, v))
    camera = sensor.get_medium()
    medium = dr.zeros(mi.MediumPtr) if camera is None else mi.MediumPtr(camera)
    _refuse_other_medium(scene, seen.o, seen.d, medium, f"sensor {sensor.id()!r}")
    for i, emitter in enumerate(scene.emitters()):
        pick = dr.full(mi.Float, (i + 0.5) / emission.count, RAY_COUNT)
        ray = emission.start(pick, mi.Point2f(x, y), u, v)
        _refuse_other_medium(scene, ray.o, ray.d, ray.medium, f"emitter {emitter.id()!r}")


def _refuse_other_medium(
    scene: mi.Scene, origin: mi.Point3f, d: mi.Vector3f, medium: mi.MediumPtr, subject: str
) -> None:
    """Raise a RenderError where most boundaries that rays reach first have another medium here."""
    going = dr.full(mi.Bool, True, RAY_COUNT)
    boundary, other = (dr.full(mi.Bool, False, RAY_COUNT) for _ in range(2))
    ray = mi.Ray3f(origin, d)
    for _ in range(CROSSED_MAX):
        si = scene.ray_intersect(ray, going)
        going &= si.is_valid()
        here = going & si.is_medium_transition()
        other |= here & (si.target_medium(-d) != medium)
        boundary |= here
        # What is no boundary has the same medium on both sides.
        going &= ~here
        ray = si.spawn_ray(d)
    if 2 * dr.count(other)[0] > dr.count(boundary)[0]:
        raise RenderError(
            f"{subject} is in another medium than it declares, allowed: the one around it; give "
            "it (or the shape of the emitter, as exterior) that medium",
            field="medium",
        )


def _filled_fraction(scene: mi.Scene, medium: mi.MediumPtr, low: Array, high: Array) -> float:
    """Return about what fraction of a box is in ``medium``, by the first face that a ray meets."""
    rng = np.random.default_rng(1)
    points = low[:, None] + (high - low)[:, None] * rng.random((3, PROBE_COUNT))
    away = rng.standard_normal((3, PROBE_COUNT))
    direction = mi.Vector3f((away / np.linalg.norm(away, axis=0)).astype(np.float32))
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(points.astype(np.float32)), direction))
    inside = si.is_valid() & si.is_medium_transition()
    inside &= si.target_medium(-direction) == medium
    return float(np.array(inside & dr.full(mi.Bool, True, PROBE_COUNT)).mean())
