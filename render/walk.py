"""Walking through surfaces and homogeneous media, one ray cast at a time.

A *segment* runs from one vertex to the next and may cross null (index-matched) boundaries. Free
paths are sampled once per segment as an optical depth, so that crossing a boundary needs no new
random number. With channel-dependent media one channel, chosen uniformly per segment, drives the
sampling and the density is the mean over channels (Wilkie et al. 2014, spectral MIS).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from render.vertex import (
    RATIO_MAX,
    Vertex,
    area_factor,
    choose,
    empty_vertex,
    extinction,
    is_null,
    leave,
    medium_interaction,
    scatter,
    surface_interaction,
)


class Aim(Protocol):
    """A sampler that some vertices mix with their BSDF (``render.guide``)."""

    def guided(self, v: Vertex) -> Any:
        """Return whether the mixture is used at ``v``."""

    def chosen(self, v: Vertex, number: Any) -> Any:
        """Return whether this number picks the guided direction."""

    def direction(self, v: Vertex, x: Any, y: Any) -> Any:
        """Return a guided world direction."""

    def mixed(self, v: Vertex, direction: Any, pdf: Any) -> Any:
        """Return the density of the mixture."""


@dataclass
class Head:
    """The moving end of a subpath (a Dr.Jit PyTree).

    ``tau`` is what is left of the sampled optical depth in the driving ``channel``; ``depth`` the
    optical depth per channel and ``length`` (mm) since the last vertex; ``sigma_from`` the
    extinction at the last vertex when that was in a volume (``from_volume``).
    """

    o: Any
    d: Any
    medium: Any
    beta: Any
    tau: Any
    channel: Any
    depth: Any
    length: Any
    vcm: Any
    vc: Any
    sigma_from: Any
    from_volume: Any


def start(o: Any, d: Any, medium: Any, beta: Any, vcm: Any, vc: Any, sample: Any) -> Head:
    """Return the head of a new segment whose free path is drawn from ``sample``."""
    channels = len(beta)
    scaled = sample * channels
    channel = dr.minimum(mi.UInt32(scaled), channels - 1)
    tau = -dr.log(dr.maximum(1.0 - (scaled - mi.Float(channel)), 1e-38))
    return Head(
        o=o, d=d, medium=medium, beta=beta, tau=tau, channel=channel,
        depth=mi.Spectrum(0), length=mi.Float(0), vcm=vcm, vc=vc,
        sigma_from=mi.Spectrum(0), from_volume=mi.Bool(False),
    )  # fmt: skip


def intersect(scene: Any, ray: Any, active: Any) -> Any:
    """Return the nearest surface with what BSDFs need, without derivatives of the surface."""
    needed = mi.RayFlags.UV | mi.RayFlags.ShadingFrame
    return scene.ray_intersect(ray, ray_flags=needed, coherent=False, active=active)


def advance(scene: Any, head: Head, active: Any) -> tuple[Head, Vertex, Any, Any]:
    """Cast one ray; return the head, the vertex, whether it is one, and whether light escaped.

    Neither means that a null boundary was crossed and the segment goes on.
    """
    si = intersect(scene, mi.Ray3f(head.o, head.d), active)
    sigma_s, sigma_t = extinction(head.medium, active)
    driving = sigma_t[0]
    for c in range(1, len(sigma_t)):
        driving = dr.select(head.channel == c, sigma_t[c], driving)
    free = dr.select(driving > 0, head.tau / driving, dr.inf)
    volume = active & (free < si.t)
    escaped = active & ~volume & ~si.is_valid()
    t = dr.select(volume, free, si.t)
    moved = active & ~escaped
    head.depth = dr.select(moved, head.depth + sigma_t * t, head.depth)
    head.length = dr.select(moved, head.length + t, head.length)
    head.tau = dr.select(moved, head.tau - driving * t, head.tau)
    crossing = moved & ~volume & is_null(si)
    arrived = moved & ~crossing
    flags = si.bsdf().flags()
    vertex = Vertex(
        p=dr.select(volume, mi.Point3f(head.o + t * head.d), si.p),
        n=si.n, frame=si.sh_frame, wi=-head.d, uv=si.uv, bsdf=si.bsdf(), shape=si.shape,
        medium=head.medium, phase=head.medium.phase_function(), volume=volume,
        diffuse=~volume & mi.has_flag(flags, mi.BSDFFlags.Diffuse),
        delta=~volume & ~mi.has_flag(flags, mi.BSDFFlags.Smooth),
        terminal=volume, beta=mi.Spectrum(0), vcm=mi.Float(0), vc=mi.Float(0),
        weight=mi.Float(1),
    )  # fmt: skip
    # exp(-(depth - least)) keeps ratios of transmittances finite however thick the medium is.
    least = dr.min(head.depth)
    relative = dr.exp(-(head.depth - least))
    forward = dr.select(volume, dr.mean(sigma_t * relative), dr.mean(relative))
    reverse = dr.select(head.from_volume, dr.mean(head.sigma_from * relative), dr.mean(relative))
    weight = relative * dr.select(volume, sigma_s, 1.0) / forward
    cosine = area_factor(vertex, head.d)
    vertex.beta = dr.select(arrived, head.beta * weight, 0.0)
    density = cosine * forward
    vertex.vcm = dr.minimum(
        head.vcm * dr.square(head.length) / (density * dr.exp(-least)), RATIO_MAX
    )
    vertex.vc = dr.minimum(head.vc * reverse / density, RATIO_MAX)
    vertex.vcm = dr.select(head.vcm > 0, vertex.vcm, 0.0)
    vertex.vc = dr.select(head.vc > 0, vertex.vc, 0.0)
    head.sigma_from = dr.select(arrived, sigma_t, head.sigma_from)
    head.from_volume = dr.select(arrived, volume, head.from_volume)
    beyond = si.spawn_ray(head.d)
    head.o = dr.select(crossing, beyond.o, head.o)
    head.medium = dr.select(
        crossing & si.is_medium_transition(), si.target_medium(head.d), head.medium
    )
    return head, vertex, arrived, escaped


def bounce(
    head: Head,
    v: Vertex,
    mode: Any,
    numbers: tuple[Any, Any, Any, Any],
    active: Any,
    aim: Aim | None = None,
) -> tuple[Head, Any]:
    """Sample a new direction at ``v``; return the head of the next segment and whether it lives.

    Updates the recursive MIS sums (Georgiev 2012, eqs. 33 to 39, no merging). A terminal vertex
    is one that a camera subpath never passes, so its reverse density counts as zero.
    """
    free, lobe, x, y = numbers
    square = mi.Point2f(x, y)
    surface, volume = active & ~v.volume, active & v.volume
    si = surface_interaction(v)
    context = mi.BSDFContext(mode)
    sample, weight = v.bsdf.sample(context, si, lobe, square, surface)
    wo_surface = v.frame.to_world(sample.wo)
    back = mi.Vector3f(si.wi)
    si.wi = sample.wo
    reverse = v.bsdf.pdf(context, si, back, surface)
    delta = surface & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
    wo_phase, phase_weight, phase_pdf = v.phase.sample(
        mi.PhaseFunctionContext(), medium_interaction(v), lobe, square, volume
    )
    wo = dr.select(v.volume, wo_phase, wo_surface)
    pdf = dr.select(v.volume, phase_pdf, sample.pdf)
    reverse = dr.select(v.volume, phase_pdf, reverse)
    weight = dr.select(v.volume, mi.Spectrum(phase_weight), weight)
    if aim is not None:
        wo = dr.select(aim.chosen(v, lobe), aim.direction(v, x, y), wo)
        value, plain, back_pdf = scatter(v, wo, mode, active & aim.guided(v))
        mixed = aim.mixed(v, wo, plain)
        pdf = dr.select(aim.guided(v), mixed, pdf)
        reverse = dr.select(aim.guided(v), back_pdf, reverse)
        weight = dr.select(aim.guided(v), value / mixed, weight)
    reverse = dr.select(v.terminal, 0.0, reverse)
    beta = v.beta * weight
    alive = active & (dr.max(beta) > 0) & (pdf > 0)
    cosine = area_factor(v, wo)
    vc = dr.select(delta, cosine * v.vc, cosine / pdf * (v.vc * reverse + v.vcm))
    vc = dr.minimum(dr.select(v.vcm + v.vc > 0, vc, 0.0), RATIO_MAX)
    vcm = dr.select(delta, 0.0, dr.minimum(1.0 / pdf, RATIO_MAX))
    origin, medium = leave(v, wo)
    after = start(origin, wo, medium, beta, vcm, vc, free)
    after.sigma_from, after.from_volume = head.sigma_from, head.from_volume
    return pick(alive, after, head), alive


def pick(condition: Any, a: Head, b: Head) -> Head:
    """Return the head ``a`` where ``condition`` holds, else ``b``."""
    return Head(**{k: dr.select(condition, getattr(a, k), getattr(b, k)) for k in vars(a)})


@dr.syntax
def cast(scene: Any, a: Vertex, direction: Any, active: Any) -> tuple[Vertex, Any, Any]:
    """Return the first real surface from ``a`` in ``direction`` and the optical depth to it.

    The third value says whether there is one. Nothing is scattered on the way.
    """
    origin, medium = leave(a, direction)
    depth = mi.Spectrum(0.0)
    found = empty_vertex()
    hit = mi.Bool(False)
    going = mi.Bool(active)
    while going:
        si = intersect(scene, mi.Ray3f(origin, direction), going)
        sigma_t = extinction(medium, going)[1]
        valid = going & si.is_valid()
        depth += dr.select(valid, sigma_t * si.t, 0.0)
        crossing = valid & is_null(si)
        arrived = valid & ~crossing
        flags = si.bsdf().flags()
        here = Vertex(
            p=si.p, n=si.n, frame=si.sh_frame, wi=-direction, uv=si.uv, bsdf=si.bsdf(),
            shape=si.shape, medium=medium, phase=dr.zeros(mi.PhaseFunctionPtr),
            volume=mi.Bool(False), diffuse=mi.has_flag(flags, mi.BSDFFlags.Diffuse),
            delta=~mi.has_flag(flags, mi.BSDFFlags.Smooth), terminal=mi.Bool(False),
            beta=mi.Spectrum(0), vcm=mi.Float(0), vc=mi.Float(0), weight=mi.Float(1),
        )  # fmt: skip
        found = choose(arrived, here, found)
        hit |= arrived
        origin = dr.select(crossing, si.spawn_ray(direction).o, origin)
        medium = dr.select(crossing & si.is_medium_transition(), si.target_medium(direction), medium)
        going = crossing
    return found, depth, hit


@dr.syntax
def optical_depth(scene: Any, a: Vertex, b: Vertex, active: Any) -> tuple[Any, Any]:
    """Return the optical depth per channel between two vertices and whether they see each other."""
    direction = dr.normalize(b.p - a.p)
    origin, medium = leave(a, direction)
    target = leave(b, -direction)[0]
    remaining = dr.norm(target - origin) * (1.0 - mi.math.ShadowEpsilon)
    depth = mi.Spectrum(0.0)
    clear = mi.Bool(active)
    going = mi.Bool(active)
    while going:
        si = intersect(scene, mi.Ray3f(origin, direction, remaining, 0.0, mi.Color0f()), going)
        t = dr.minimum(si.t, remaining)
        sigma_t = extinction(medium, going)[1]
        depth += sigma_t * t
        hit = going & si.is_valid()
        crossing = hit & is_null(si)
        clear &= ~hit | crossing
        beyond = si.spawn_ray(direction)
        step = dr.norm(beyond.o - origin)
        origin = dr.select(crossing, beyond.o, origin)
        medium = dr.select(
            crossing & si.is_medium_transition(), si.target_medium(direction), medium
        )
        remaining = dr.select(crossing, remaining - step, remaining)
        going = crossing & (remaining > 0)
    return depth, clear


def join(
    scene: Any,
    y: Vertex,
    z: Vertex,
    active: Any,
    aim: Aim | None = None,
    extra: Any = 0.0,
    bridged: Any = 0.0,
) -> Any:
    """Return the MIS-weighted contribution of joining light vertex ``y`` to camera vertex ``z``.

    Balance heuristic over all strategies (Veach 1997, eq. 10.9) from the recursive sums.
    ``extra`` is the density ratio of a further strategy to this one; ``bridged`` that of a
    further strategy to the camera subpath that ends before ``z``.
    """
    span = z.p - y.p
    distance_squared = dr.squared_norm(span)
    w = span * dr.rsqrt(distance_squared)
    active = active & (y.weight > 0) & (z.weight > 0) & (distance_squared > 0)
    f_y, p_y, r_y = scatter(y, w, mi.TransportMode.Importance, active)
    f_z, p_z, r_z = scatter(z, -w, mi.TransportMode.Radiance, active)
    if aim is not None:
        p_z = dr.select(aim.guided(z), aim.mixed(z, -w, p_z), p_z)
    value = y.beta * f_y * f_z * z.beta / distance_squared
    active = active & (dr.max(value) > 0)
    depth, clear = optical_depth(scene, y, z, active)
    transmittance = dr.exp(-depth)
    _, sigma_y = extinction(y.medium, active & y.volume)
    _, sigma_z = extinction(z.medium, active & z.volume)
    mean_t = dr.mean(transmittance)
    reach_y = dr.select(y.volume, dr.mean(sigma_y * transmittance), mean_t)
    reach_z = dr.select(z.volume, dr.mean(sigma_z * transmittance), mean_t)
    camera_density = p_z * area_factor(y, w) * reach_y / distance_squared
    light_density = p_y * area_factor(z, w) * reach_z / distance_squared
    r_y = dr.select(y.terminal, 0.0, r_y)
    light_ratio = dr.select(z.terminal, 0.0, camera_density * (y.vcm + y.vc * r_y))
    camera_ratio = light_density * (z.vcm + z.vc * r_z)
    further = extra + light_density * z.vcm * bridged
    mis = 1.0 / (1.0 + light_ratio + camera_ratio + further)
    return dr.select(clear & active, value * transmittance * mis * y.weight * z.weight, 0.0)
