"""Walking through surfaces and homogeneous media, one ray cast at a time.

A *segment* runs from one vertex to the next and may cross null (index-matched) boundaries. Free
paths are sampled once per segment as an optical depth, so that crossing a boundary needs no new
random number. With channel-dependent media one channel, chosen uniformly per segment, drives the
sampling and the density is the mean over channels (Wilkie et al. 2014, spectral MIS).

Equation numbers are those of Georgiev 2012, "Implementing vertex connection and merging".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi

from render.paths.vertex import (
    RATIO_MAX,
    VOLUME_PASSES,
    EitherMode,
    PassableVertex,
    Vertex,
    area_factor,
    by_mode,
    channel_mean,
    d_vc_for,
    evaluate_scattering,
    extinction,
    is_null,
    leave,
    medium_interaction,
    passes_behind,
    reverse_pdf,
    shading_factor,
    surface_interaction,
)


class GuidingDistribution(Protocol):
    """Directions that some vertices mix with their BSDF (``render.cells.guiding``)."""

    def applies(self, v: Vertex) -> mi.Bool:
        """Return whether the mixture is used at ``v``."""

    def selected(self, v: Vertex, number: mi.Float) -> mi.Bool:
        """Return whether this number picks the guided direction."""

    def unselected(self, v: Vertex, number: mi.Float) -> mi.Float:
        """Return a number in [0, 1) again, for the BSDF, of one that was not ``selected``."""

    def sample(self, v: Vertex, number: mi.Float, x: mi.Float, y: mi.Float) -> mi.Vector3f:
        """Return a guided world direction; ``number`` is the one that was ``selected``."""

    def mixture_pdf(self, v: Vertex, direction: mi.Vector3f, pdf: mi.Float) -> mi.Float:
        """Return the density of the mixture."""


def guided_pdf(
    guiding: GuidingDistribution | None, v: Vertex, direction: mi.Vector3f, pdf: mi.Float
) -> mi.Float:
    """Return the density with which subpaths leave ``v`` in ``direction``.

    ``pdf`` is that of scattering alone, ``guiding`` what such subpaths mix with it, if anything.
    """
    if guiding is None:
        return pdf
    return dr.select(guiding.applies(v), guiding.mixture_pdf(v, direction, pdf), pdf)


@dataclass
class SubpathState:
    """The moving end of a subpath (a Dr.Jit PyTree).

    ``tau`` is what remains of the sampled optical depth in the driving ``channel``; ``depth`` the
    optical depth per channel and ``length`` (mm) since the last vertex; ``sigma_from`` the
    extinction at the last vertex when that was in a volume (``from_volume``).
    """

    o: mi.Point3f
    d: mi.Vector3f
    medium: mi.MediumPtr
    beta: mi.Spectrum
    tau: mi.Float
    channel: mi.UInt32
    depth: mi.Spectrum
    length: mi.Float
    d_vcm: mi.Float
    d_vc: mi.Float
    sigma_from: mi.Spectrum
    from_volume: mi.Bool


@dataclass
class PassableState(SubpathState):
    """The state of a subpath of ``PassableVertex``."""

    d_vc_passing: mi.Vector2f

    @staticmethod
    def of(state: SubpathState) -> PassableState:
        """Return ``state`` with the same sum for all camera subpaths."""
        return PassableState(**vars(state), d_vc_passing=mi.Vector2f(state.d_vc))


def begin_subpath(
    o: mi.Point3f, d: mi.Vector3f, medium: mi.MediumPtr, beta: mi.Spectrum, d_vcm: mi.Float,
    d_vc: mi.Float, sample: mi.Float,
) -> SubpathState:  # fmt: skip
    """Return the state at the start of a new segment whose free path is drawn from ``sample``."""
    channels = len(beta)
    scaled = sample * channels
    channel = dr.minimum(mi.UInt32(scaled), channels - 1)
    tau = -dr.log(dr.maximum(1.0 - (scaled - mi.Float(channel)), 1e-38))
    return SubpathState(
        o=mi.Point3f(o), d=mi.Vector3f(d), medium=medium, beta=beta, tau=tau, channel=channel,
        depth=mi.Spectrum(0), length=mi.Float(0), d_vcm=d_vcm, d_vc=d_vc,
        sigma_from=mi.Spectrum(0), from_volume=mi.Bool(False),
    )  # fmt: skip


def in_vacuum(state: SubpathState) -> SubpathState:
    """Return ``state`` in a scene without media, known when kernels are compiled."""
    state.medium, state.from_volume = dr.zeros(mi.MediumPtr), mi.Bool(False)
    state.tau, state.channel = mi.Float(0.0), mi.UInt32(0)
    state.depth, state.sigma_from = mi.Spectrum(0.0), mi.Spectrum(0.0)
    return state


def intersect(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> mi.SurfaceInteraction3f:
    """Return the nearest surface with what BSDFs need: anisotropic ones follow its parameters."""
    needed = mi.RayFlags.UV | mi.RayFlags.dPdUV | mi.RayFlags.ShadingFrame
    return scene.ray_intersect(ray, ray_flags=needed, coherent=False, active=active)


def trace_segment(
    scene: mi.Scene, state: SubpathState, active: mi.Bool, reach: mi.Float | None = None,
    nulls: bool = True,
) -> tuple[SubpathState, Vertex, mi.Bool, mi.Bool]:  # fmt: skip
    """Cast one ray; return the state, the vertex, whether it is one, and whether light escaped.

    Neither means that a null boundary was crossed and the segment goes on. Light also escapes where
    the segment gets as long as ``reach``, if that is given. ``nulls`` are such boundaries.
    """
    # -------------------- Free path, or the nearest surface ---------------------
    sigma_s, sigma_t = extinction(state.medium, active)
    driving = sigma_t[0]
    for c in range(1, len(sigma_t)):
        driving = dr.select(state.channel == c, sigma_t[c], driving)
    free = dr.select(driving > 0, state.tau / driving, dr.inf)
    # Rays that end with the free path are much cheaper to cast than unbounded ones.
    end = free if reach is None else dr.minimum(free, reach - state.length)
    si = intersect(scene, mi.Ray3f(mi.Ray3f(state.o, state.d), end), active)
    volume = active & (driving > 0) & (free < si.t)
    if reach is not None:
        volume &= free <= end
    escaped = active & ~volume & ~si.is_valid()
    t = dr.select(volume, free, si.t)
    moved = active & ~escaped
    if reach is not None:
        state.depth += dr.select(escaped & (end < dr.inf), sigma_t * end, 0.0)
    state.depth = dr.select(moved, state.depth + sigma_t * t, state.depth)
    state.length = dr.select(moved, state.length + t, state.length)
    state.tau = dr.select(moved, state.tau - driving * t, state.tau)
    bsdf = si.bsdf()
    flags = bsdf.flags()
    crossing = moved & ~volume & is_null(flags) if nulls else mi.Bool(False)
    arrived = moved & ~crossing
    vertex = Vertex(
        p=dr.select(volume, mi.Point3f(state.o + t * state.d), si.p),
        n=si.n, frame=si.sh_frame, wi=-state.d, uv=si.uv, bsdf=bsdf, shape=si.shape,
        medium=state.medium, phase=state.medium.phase_function(), volume=volume,
        diffuse=~volume & mi.has_flag(flags, mi.BSDFFlags.Diffuse),
        delta=~volume & ~mi.has_flag(flags, mi.BSDFFlags.Smooth),
        terminal=volume, beta=mi.Spectrum(0), d_vcm=mi.Float(0), d_vc=mi.Float(0),
        weight=mi.Float(1),
    )  # fmt: skip
    # -------------------- Throughput and MIS sums on arrival --------------------
    # exp(-(depth - least)) keeps ratios of transmittances finite however thick the medium is.
    least = dr.min(state.depth)
    relative = dr.exp(-(state.depth - least))
    forward = dr.select(volume, channel_mean(sigma_t * relative), channel_mean(relative))
    reverse = dr.select(
        state.from_volume, channel_mean(state.sigma_from * relative), channel_mean(relative)
    )
    weight = relative * dr.select(volume, sigma_s, 1.0) / forward
    cosine = area_factor(vertex, state.d)
    vertex.beta = dr.select(arrived, state.beta * weight, 0.0)
    density = cosine * forward
    # Eqs. 31 to 36: the distance and the cosine of the arrival, known only now.
    vertex.d_vcm = dr.minimum(
        state.d_vcm * dr.square(state.length) / (density * dr.exp(-least)), RATIO_MAX
    )
    vertex.d_vc = dr.minimum(state.d_vc * reverse / density, RATIO_MAX)
    vertex.d_vcm = dr.select(state.d_vcm > 0, vertex.d_vcm, 0.0)
    vertex.d_vc = dr.select(state.d_vc > 0, vertex.d_vc, 0.0)
    if isinstance(state, PassableState):
        passing = dr.minimum(state.d_vc_passing * reverse / density, RATIO_MAX)
        passing = dr.select(state.d_vc_passing > 0, passing, 0.0)
        vertex = PassableVertex(**vars(vertex), d_vc_passing=passing)
    # ------------------------- Step off, or across ------------------------------
    state.sigma_from = dr.select(arrived, sigma_t, state.sigma_from)
    state.from_volume = dr.select(arrived, volume, state.from_volume)
    beyond = si.spawn_ray(state.d)
    state.o = dr.select(crossing, beyond.o, state.o)
    state.medium = dr.select(
        crossing & si.is_medium_transition(), si.target_medium(state.d), state.medium
    )
    return state, vertex, arrived, escaped


def sample_scattering(
    state: SubpathState,
    v: Vertex,
    mode: mi.TransportMode | EitherMode,
    numbers: tuple[mi.Float, mi.Float, mi.Float, mi.Float],
    active: mi.Bool,
    guiding: GuidingDistribution | None = None,
    returning: GuidingDistribution | None = None,
) -> tuple[SubpathState, mi.Bool]:
    """Sample a new direction at ``v``; return the state of the next segment and whether it lives.

    Updates the recursive MIS sums (eqs. 34 and 35; 53 and 54 at delta scattering; no merging). A
    terminal vertex is one that a camera subpath never passes, so its reverse density counts as 0.
    ``returning`` is what subpaths mix that come the other way.
    """
    # -------------------- Direction from the BSDF or the phase function ----------
    free, lobe, x, y = numbers
    square = mi.Point2f(x, y)
    surface, volume = active & ~v.volume, active & v.volume
    si = surface_interaction(v)
    # A BSDF of several parts draws one of them by the number that selects guided directions.
    part = lobe if guiding is None else guiding.unselected(v, lobe)

    def sampled(
        bsdf: mi.BSDF, context: mi.BSDFContext, on: mi.Bool, si: mi.SurfaceInteraction3f,
        part: mi.Float, square: mi.Point2f,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum, mi.Float]:  # fmt: skip
        sample, weight = bsdf.sample(context, si, part, square, on)
        return sample, weight, reverse_pdf(bsdf, si, sample.wo, on)

    sample, weight, reverse = by_mode(mode, v.bsdf, surface, sampled, si, part, square)
    wo_surface = v.frame.to_world(sample.wo)
    delta = surface & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
    wo_phase, phase_weight, phase_pdf = v.phase.sample(
        mi.PhaseFunctionContext(), medium_interaction(v), lobe, square, volume
    )
    wo = dr.select(v.volume, wo_phase, wo_surface)
    pdf = dr.select(v.volume, phase_pdf, sample.pdf)
    reverse = dr.select(v.volume, phase_pdf, reverse)
    weight = dr.select(v.volume, mi.Spectrum(phase_weight), weight * shading_factor(v, wo, mode))
    if guiding is not None:
        applies = guiding.applies(v)
        wo = dr.select(guiding.selected(v, lobe), guiding.sample(v, lobe, x, y), wo)
        value, unguided_pdf, guided_reverse = evaluate_scattering(v, wo, mode, active & applies)
        mixture_pdf = guiding.mixture_pdf(v, wo, unguided_pdf)
        pdf = dr.select(applies, mixture_pdf, pdf)
        reverse = dr.select(applies, guided_reverse, reverse)
        weight = dr.select(applies, value / mixture_pdf, weight)
    reverse = guided_pdf(returning, v, v.wi, reverse)
    passing_reverse = reverse
    reverse = dr.select(v.terminal, 0.0, reverse)
    beta = v.beta * weight
    alive = active & (dr.max(beta) > 0) & (pdf > 0)
    # ------------------------- MIS sums of the next segment ----------------------
    cosine = area_factor(v, wo)
    # Eq. 35; eq. 54 at delta scattering.
    d_vc = dr.select(delta, cosine * v.d_vc, cosine / pdf * (v.d_vc * reverse + v.d_vcm))
    d_vc = dr.minimum(dr.select(v.d_vcm + v.d_vc > 0, d_vc, 0.0), RATIO_MAX)
    # Eq. 34; eq. 53 at delta scattering.
    d_vcm = dr.select(delta, 0.0, dr.minimum(1.0 / pdf, RATIO_MAX))
    origin, medium = leave(v, wo)
    following = begin_subpath(origin, wo, medium, beta, d_vcm, d_vc, free)
    if isinstance(v, PassableVertex):
        sums = mi.Vector2f(0.0)
        for i in range(VOLUME_PASSES):
            behind = d_vc_for(v, passes_behind(v, mi.UInt32(i + 1)))
            passing = cosine / pdf * (behind * passing_reverse + v.d_vcm)
            sums[i] = dr.select(v.d_vcm + behind > 0, passing, 0.0)
        # A specular face lets camera subpaths pass volumes again.
        passing = cosine * v.d_vc_passing[VOLUME_PASSES - 1]
        sums = dr.minimum(dr.select(delta, passing, sums), RATIO_MAX)
        following.d_vc = dr.select(delta, sums[VOLUME_PASSES - 1], following.d_vc)
        following = PassableState(**vars(following), d_vc_passing=sums)
    following.sigma_from, following.from_volume = state.sigma_from, state.from_volume
    return dr.select(alive, following, state), alive
