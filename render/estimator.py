"""Bidirectional path tracing on one page, without any engineering (Veach 1997, chapter 10).

For reading beside the paper, and as an oracle: `bdpt` computes the same image from other formulas
(recursive weights, shared light vertices, mirror connections) and shares no code with it.

A path from a light to the pinhole is found by every split into a light subpath ``y_0 ... y_{s-1}``
and a camera subpath ``z_0 ... z_{t-1}``. With the density ``p_i`` of each split (eq. 10.5) the
balance heuristic ``w = p_s / sum_i p_i`` (eq. 9.8) makes the sum of ``w f / p_s`` over all splits
an unbiased estimate of every pixel. Media have vertices of their own (Lafortune and Willems 1996).

Area lights, BSDFs that are smooth or delta but not both, homogeneous media of one coefficient for
all colors whose boundaries have a BSDF, a pinhole. Lengths in scene units, float32, mono or rgb.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array


@dataclass
class PathVertex:
    """A vertex of a subpath, found through ``medium``, facing back along ``wi``.

    ``alpha`` is Veach's weight of the subpath up to here (eq. 10.6). Densities per area (in media
    per volume): ``forward`` of finding it from the vertex before, ``reverse`` from the one behind.
    """

    si: mi.SurfaceInteraction3f
    volume: mi.Bool
    medium: mi.MediumPtr
    wi: mi.Vector3f
    alpha: mi.Spectrum
    forward: mi.Float
    active: mi.Bool
    reverse: mi.Float
    delta: mi.Bool
    light: mi.EmitterPtr | None = None  # y_0 only

    def scatter(self, wi: mi.Vector3f, wo: mi.Vector3f, mode: Any) -> tuple[Any, Any]:
        """Return ``f`` with the cosine of ``wo``, and the density of ``wo`` per solid angle."""
        si = mi.SurfaceInteraction3f(self.si)
        if self.light is not None:
            si.wi = si.to_local(wo)
            cosine = dr.maximum(si.wi.z, 0.0)
            return self.light.eval(si, self.active) * cosine, cosine / dr.pi
        si.wi = si.to_local(wi)
        surface, context = self.active & ~self.volume, mi.BSDFContext(mode)
        f, pdf = si.bsdf().eval_pdf(context, si, si.to_local(wo), surface)
        phase, phase_pdf = self.medium.phase_function().eval_pdf(
            mi.PhaseFunctionContext(), in_medium(wi), wo, self.active & self.volume
        )
        return dr.select(self.volume, phase, f), dr.select(self.volume, phase_pdf, pdf)

    def medium_towards(self, wo: mi.Vector3f) -> mi.MediumPtr:
        """Return the medium of a ray that leaves in direction ``wo``."""
        crosses = self.active & ~self.volume & self.si.is_medium_transition()
        return dr.select(crosses, self.si.target_medium(wo), self.medium)


def in_medium(wi: mi.Vector3f) -> mi.MediumInteraction3f:
    """Return a medium interaction that faces ``wi``."""
    mei = dr.zeros(mi.MediumInteraction3f)
    mei.wi, mei.sh_frame = wi, mi.Frame3f(wi)
    return mei


def coefficients(medium: mi.MediumPtr, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
    """Return scattering and extinction in 1/length; 0 outside of media."""
    inside = active & (medium != None)  # noqa: E711 (a Dr.Jit pointer array)
    s, _, t = medium.get_scattering_coefficients(dr.zeros(mi.MediumInteraction3f), inside)
    return dr.select(inside, s[0], 0.0), dr.select(inside, t[0], 0.0)


def density(pdf: mi.Float, a: PathVertex, b: PathVertex, medium: mi.MediumPtr) -> mi.Float:
    """Return the density per area at ``b`` of a direction with ``pdf`` per solid angle at ``a``."""
    span = b.si.p - a.si.p
    distance = dr.norm(span)
    _, sigma = coefficients(medium, b.active)
    arrival = dr.exp(-sigma * distance) * dr.select(b.volume, sigma, 1.0)
    cosine = dr.select(b.volume, 1.0, dr.abs(dr.dot(b.si.n, span / distance)))
    return pdf * arrival * cosine / dr.square(distance)


def subpath(
    scene: mi.Scene,
    first: PathVertex,
    wo: Any,
    pdf: Any,
    alpha: Any,
    mode: Any,
    rng: Any,
    length: int,
) -> list[PathVertex]:
    """Return ``first`` and ``length`` vertices behind it; it is left along ``wo``."""
    path, medium, zero = [first], first.medium, first.reverse
    for _ in range(length):
        last = path[-1]
        ray = last.si.spawn_ray(wo)
        si = scene.ray_intersect(ray, last.active)
        # A free path ends in the medium, or the surface comes first.
        sigma_s, sigma_t = coefficients(medium, last.active)
        free = -dr.log(1.0 - rng.next_float32()) / sigma_t
        volume = last.active & (sigma_t > 0) & (free < si.t)
        si.p, si.n = dr.select(volume, ray(free), si.p), dr.select(volume, 0.0, si.n)
        si.wi = dr.select(volume, si.wi, si.to_local(-wo))
        surface = last.active & ~volume & si.is_valid()
        alpha = alpha * dr.select(volume, sigma_s / sigma_t, 1.0)
        delta = surface & ~mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth)
        v = PathVertex(si, volume, medium, -wo, alpha, zero, volume | surface, zero, delta)
        v.forward = density(pdf, last, v, medium)
        path.append(v)
        u, square = rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32())
        bs, weight = si.bsdf().sample(mi.BSDFContext(mode), si, u, square, surface)
        wo_medium, phase_weight, phase_pdf = medium.phase_function().sample(
            mi.PhaseFunctionContext(), in_medium(v.wi), u, square, volume
        )
        wo = dr.select(volume, wo_medium, si.to_world(bs.wo))
        pdf = dr.select(volume, phase_pdf, bs.pdf)
        alpha = alpha * dr.select(volume, mi.Spectrum(phase_weight), weight)
        _, back = v.scatter(wo, v.wi, mode)
        last.reverse = density(dr.select(delta, pdf, back), v, last, medium)
        medium = v.medium_towards(wo)
        dr.eval(v, last.reverse, wo, pdf, alpha, medium, rng)
    return path


def heuristic(
    light: list[PathVertex], camera: list[PathVertex], reverse: dict[int, Any]
) -> mi.Float:
    """Return ``w`` (eq. 9.8) of two joined subpaths by ratios of densities (eq. 10.9).

    ``reverse`` holds what the connection decides, by ``id`` of the vertex.
    """
    total = mi.Float(1.0)
    for path, least in ((light, 0), (camera, 1)):
        ratio = mi.Float(1.0)
        for i in range(len(path) - 1, least - 1, -1):
            v = path[i]
            ratio *= reverse.get(id(v), v.reverse) / v.forward
            joined = ~(v.delta | path[i - 1].delta) if i else ~v.delta
            total += dr.select(joined & (v.forward > 0), ratio, 0.0)
    return dr.rcp(total)


def connect(
    scene: mi.Scene, sensor: mi.Sensor, light: list[PathVertex], camera: list[PathVertex]
) -> Any:
    """Return ``w f / p`` of the path through both ends (eq. 10.8), and where it meets the film."""
    z, reverse = camera[-1], {}
    if not light:  # the camera subpath ends on a light
        emitter = z.si.emitter(scene)
        found = z.active & ~z.volume & (emitter != None)  # noqa: E711
        area = z.si.shape.pdf_position(mi.PositionSample3f(z.si), found)
        reverse[id(z)] = area / len(scene.emitters())
        cosine = dr.maximum(z.si.wi.z, 0.0)
        reverse[id(camera[-2])] = density(cosine / dr.pi, z, camera[-2], z.medium)
        value = z.alpha * emitter.eval(z.si, found) * heuristic(light, camera, reverse)
        return dr.select(found, value, 0.0), None
    y, importance = light[-1], mi.TransportMode.Importance
    active = y.active & z.active & ~y.delta & ~z.delta
    span = z.si.p - y.si.p
    wo = dr.normalize(span)
    medium = y.medium_towards(wo)
    f, pdf = y.scatter(y.wi, wo, importance)
    value, uv = y.alpha * f, None
    reverse[id(z)] = density(pdf, y, z, medium)
    if len(camera) == 1:  # the light subpath is seen from the pinhole
        ds, seen = sensor.sample_direction(y.si, mi.Point2f(0.5), active)
        value, uv, back = value * seen, ds.uv, direction_density(sensor, z.si.p, -wo)
    else:
        g, back = z.scatter(z.wi, -wo, mi.TransportMode.Radiance)
        value *= g * z.alpha / dr.squared_norm(span)
        _, further = z.scatter(-wo, z.wi, mi.TransportMode.Radiance)
        reverse[id(camera[-2])] = density(further, z, camera[-2], z.medium)
    reverse[id(y)] = density(back, z, y, medium)
    if len(light) > 1:
        _, further = y.scatter(wo, y.wi, importance)
        reverse[id(light[-2])] = density(further, y, light[-2], y.medium)
    _, sigma = coefficients(medium, active)
    active &= (dr.max(value) > 0) & ~scene.ray_test(y.si.spawn_ray_to(z.si.p), active)
    value *= dr.exp(-sigma * dr.norm(span)) * heuristic(light, camera, reverse)
    return dr.select(active, value, 0.0), uv


def direction_density(sensor: mi.Sensor, origin: mi.Point3f, d: mi.Vector3f) -> mi.Float:
    """Return the density per solid angle of directions from the pinhole: its importance."""
    ahead = dr.zeros(mi.Interaction3f, dr.width(d))
    ahead.p = origin + d
    return dr.mean(sensor.sample_direction(ahead, mi.Point2f(0.5))[1])


def bidirectional_image(scene: mi.Scene, samples: int, edges: int, seed: int = 0) -> Array:
    """Return radiance ``(row, column, channel)``: the mean of ``samples`` per pixel.

    ``edges`` is the longest path's number of edges; ``seed`` fixes all random numbers.
    """
    sensor, lights = scene.sensors()[0], scene.emitters_dr()
    width, height = (int(n) for n in sensor.film().crop_size())
    count = samples * width * height
    rng = mi.PCG32(count, initstate=seed)
    zero, outside = dr.zeros(mi.Float, count), dr.zeros(mi.MediumPtr, count)
    yes, no, one = dr.full(mi.Bool, True, count), dr.full(mi.Bool, False, count), mi.Spectrum(1)
    # z_0 is the pinhole; the directions from it are those of uniform film positions.
    film = mi.Point2f(rng.next_float32(), rng.next_float32())
    ray, alpha = sensor.sample_ray(zero, zero, film, mi.Point2f(0.5))
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.p = mi.Point3f(sensor.world_transform().translation())
    z_0 = PathVertex(si, no, outside, -ray.d, one, zero, yes, zero, no)
    pdf, radiance = direction_density(sensor, si.p, ray.d), mi.TransportMode.Radiance
    camera = subpath(scene, z_0, ray.d, pdf, alpha, radiance, rng, edges)
    # y_0 is uniform on a light, each as likely as any; directions from it follow the cosine.
    light = dr.gather(mi.EmitterPtr, lights, scene.sample_emitter(rng.next_float32())[0])
    ps, _ = light.sample_position(zero, mi.Point2f(rng.next_float32(), rng.next_float32()))
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.p, si.n, si.sh_frame = ps.p, ps.n, mi.Frame3f(ps.n)
    area = ps.pdf / dr.width(lights)
    y_0 = PathVertex(si, no, outside, ps.n, one / area, area, yes, zero, no, light)
    square = mi.Point2f(rng.next_float32(), rng.next_float32())
    wo = si.to_world(mi.warp.square_to_cosine_hemisphere(square))
    emitted, pdf = y_0.scatter(wo, wo, None)
    alpha, importance = y_0.alpha * emitted / pdf, mi.TransportMode.Importance
    lit = subpath(scene, y_0, wo, pdf, alpha, importance, rng, edges - 1)
    image = np.zeros((height * width, len(one)))
    for t in range(1, edges + 2):
        for s in range(1 if t == 1 else 0, edges + 2 - t):
            value, uv = connect(scene, sensor, lit[:s], camera[:t])
            place = film * mi.ScalarVector2f(width, height) if uv is None else uv
            column, row = np.array(place).astype(np.int64)
            pixel = np.clip(row, 0, height - 1) * width + np.clip(column, 0, width - 1)
            for c, channel in enumerate(value):
                image[:, c] += np.bincount(pixel, np.array(channel), height * width)
    return image.reshape(height, width, -1) / samples
