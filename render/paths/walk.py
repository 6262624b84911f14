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

from render.paths.vertex import (
    PASSES,
    RATIO_MAX,
    OpenVertex,
    Vertex,
    area_factor,
    extinction,
    is_null,
    leave,
    left_after,
    medium_interaction,
    scatter,
    surface_interaction,
    vc_of,
)


class Aim(Protocol):
    """A sampler that some vertices mix with their BSDF (``render.cells.guiding``)."""

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


@dataclass
class OpenHead(Head):
    """The head of a subpath of ``OpenVertex``."""

    vc_open: Any


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
    sigma_s, sigma_t = extinction(head.medium, active)
    driving = sigma_t[0]
    for c in range(1, len(sigma_t)):
        driving = dr.select(head.channel == c, sigma_t[c], driving)
    free = dr.select(driving > 0, head.tau / driving, dr.inf)
    # Rays that end with the free path are much cheaper to cast than unbounded ones.
    si = intersect(scene, mi.Ray3f(mi.Ray3f(head.o, head.d), free), active)
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
    if isinstance(head, OpenHead):
        opened = dr.minimum(head.vc_open * reverse / density, RATIO_MAX)
        vertex = OpenVertex(**vars(vertex), vc_open=dr.select(head.vc_open > 0, opened, 0.0))
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
        value, plain, guided_back = scatter(v, wo, mode, active & aim.guided(v))
        mixed = aim.mixed(v, wo, plain)
        pdf = dr.select(aim.guided(v), mixed, pdf)
        reverse = dr.select(aim.guided(v), guided_back, reverse)
        weight = dr.select(aim.guided(v), value / mixed, weight)
    back_pdf = reverse
    reverse = dr.select(v.terminal, 0.0, reverse)
    beta = v.beta * weight
    alive = active & (dr.max(beta) > 0) & (pdf > 0)
    cosine = area_factor(v, wo)
    vc = dr.select(delta, cosine * v.vc, cosine / pdf * (v.vc * reverse + v.vcm))
    vc = dr.minimum(dr.select(v.vcm + v.vc > 0, vc, 0.0), RATIO_MAX)
    vcm = dr.select(delta, 0.0, dr.minimum(1.0 / pdf, RATIO_MAX))
    origin, medium = leave(v, wo)
    after = start(origin, wo, medium, beta, vcm, vc, free)
    if isinstance(v, OpenVertex):
        sums: Any = mi.Vector2f(0.0)
        for i in range(PASSES):
            onward = vc_of(v, left_after(v, mi.UInt32(i + 1)))
            opened = cosine / pdf * (onward * back_pdf + v.vcm)
            sums[i] = dr.select(v.vcm + onward > 0, opened, 0.0)
        # A smooth face opens camera subpaths again.
        opened = cosine * v.vc_open[PASSES - 1]
        sums = dr.minimum(dr.select(delta, opened, sums), RATIO_MAX)
        after.vc = dr.select(delta, sums[PASSES - 1], after.vc)
        after = OpenHead(**vars(after), vc_open=sums)
    after.sigma_from, after.from_volume = head.sigma_from, head.from_volume
    return pick(alive, after, head), alive


def pick(condition: Any, a: Head, b: Head) -> Head:
    """Return the head ``a`` where ``condition`` holds, else ``b``."""
    picked = {k: dr.select(condition, getattr(a, k), getattr(b, k)) for k in vars(b)}
    return type(b)(**picked)
