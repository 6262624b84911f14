"""Choosing one of many light vertices for a camera vertex, by resampling in two steps.

Resampled importance sampling (``render.sampling.reservoirs``): a *proxy weight* draws one of a
handful, a *target weight* one of what the proxy weights drew, as ReSTIR does from many lights.

The proxy weight is what fits into a few dozen operations: power, distance, how both ends roughly
scatter, and the distance below which other strategies take over. For a pair no ray is cast and no
BSDF asked; glossy vertices know from theirs where they scatter most. The target weight is the
contribution of a connection as if only the medium of the light vertex were in the way, up to its
end (``render.integrators.medium_boxes``). Both are positive wherever the contribution can be, so
their errors cost time, not truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from render.integrators.medium_boxes import OPTICAL_DEPTH_MAX, MediumBoxes
from render.integrators.mirror_connections import MirrorSet
from render.integrators.subpaths import SubpathVertex
from render.paths.records import write_row
from render.paths.vertex import (
    Vertex,
    channel_mean,
    extinction,
    has_wide_lobe,
    scattering_value,
    surface_interaction,
)

LOBE_MIN = 0.05
"""Least that a vertex seems to scatter in proxy weights, relative to all directions alike."""
LOBE_NORM = 4.0
"""1 / average of the lobe of a volume over all directions, 1 / 5 + LOBE_MIN."""
GLOSSY_SHARPNESS = 4.0
"""1 / (peak times width) of the lobes of glossy vertices in proxy weights, widths as 1 - cosine."""
PEAK_MAX = 1000.0
"""Most that a glossy vertex seems to scatter, relative to a white diffuse surface."""
OTHER_MIRRORS = 0.05
"""What mirrors beside the likeliest reflect in proxy weights, relative to that one."""
MIRRORED_LOBE_MIN = 0.02
"""Added to what either end of a mirror connection scatters (1/sr).

Its direction varies about the mirror image's.
"""


@dataclass
class LightCandidate:
    """A light vertex that proxy weights drew for a camera vertex (a Dr.Jit PyTree).

    ``row`` is where its record is; it stands for ``represented`` vertices. Mirror connections
    have a ``mirror`` too, which was selected with ``probability``.
    """

    row: mi.UInt32
    represented: mi.Float
    mirror: mi.UInt32
    probability: mi.Float

    @staticmethod
    def none() -> LightCandidate:
        """Return one that stands for no vertex."""
        return LightCandidate(mi.UInt32(0), mi.Float(0.0), mi.UInt32(0), mi.Float(0.0))


# -- proxy weights -----------------------------------------------------------------------------


@dataclass
class LightProxies:
    """What proxy weights know of a light vertex (a Dr.Jit PyTree).

    ``back`` points away from where the vertex scatters most: straight ahead in a volume, along the
    brighter one of ``glossy_lobes`` at a glossy surface, whose light is the ``peak``.
    """

    p: mi.Point3f
    back: mi.Vector3f
    power: mi.Float
    peak: mi.Float
    volume: mi.Bool
    wide: mi.Bool
    edges: mi.UInt32
    d_vcm: mi.Float
    d_vc: mi.Float
    d_vc_passing: mi.Float

    @staticmethod
    def of(light: SubpathVertex, represented: mi.Float) -> LightProxies:
        """Return it; the power of a vertex is that of all that it stands for."""
        v = light.vertex
        sigma = channel_mean(extinction(v.medium, v.volume & (represented > 0))[1])
        # Sums of balance heuristics per density per solid angle, for isotropic scattering.
        per = dr.select(v.volume, sigma / (4.0 * dr.pi), 0.0)
        wide = has_wide_lobe(v)
        glossy = ~wide & (represented > 0)
        (axis, peak), (refracted, beyond) = glossy_lobes(v, mi.TransportMode.Importance, glossy)
        axis, peak = dr.select(beyond > peak, refracted, axis), dr.maximum(peak, beyond)
        return LightProxies(
            v.p, dr.select(wide, v.wi, -axis), channel_mean(v.beta) * represented,
            dr.select(wide, 1.0, peak), v.volume, wide, light.edges,
            per * v.d_vcm, per * v.d_vc / (4.0 * dr.pi), per * v.d_vc_passing[0] / (4.0 * dr.pi),
        )  # fmt: skip


@dataclass
class CameraProxy:
    """A kept camera vertex as proxy weights know it (a Dr.Jit PyTree).

    ``ahead`` goes on straight from it, or refracted; ``mirrored`` is the reflected direction. At a
    glossy vertex they have the light ``peaks``.
    """

    p: mi.Point3f
    valid: mi.Bool
    edges: mi.UInt32
    passes: mi.UInt32
    terminal: mi.Bool
    volume: mi.Bool
    diffuse: mi.Bool
    n: mi.Vector3f
    ahead: mi.Vector3f
    mirrored: mi.Vector3f
    peaks: mi.Vector2f
    sigma: mi.Float
    d_vcm: mi.Float
    d_vc: mi.Float

    @staticmethod
    def of(camera: SubpathVertex) -> CameraProxy:
        """Prepare the vertex ``camera``."""
        z = camera.vertex
        n = mi.Vector3f(z.frame.n)
        n = dr.select(dr.dot(n, z.wi) < 0, -n, n)
        sigma = channel_mean(extinction(z.medium, z.volume)[1])
        per = dr.select(z.volume, sigma / (4.0 * dr.pi), 0.0)
        glossy = (z.weight > 0) & ~has_wide_lobe(z)
        (mirrored, reflected), (ahead, refracted) = glossy_lobes(
            z, mi.TransportMode.Radiance, glossy
        )
        return CameraProxy(
            z.p, z.weight > 0, camera.edges, camera.passes, z.terminal, z.volume, z.diffuse, n,
            dr.select(glossy, ahead, -z.wi), mirrored, mi.Vector2f(reflected, refracted), sigma,
            per * z.d_vcm, per * z.d_vc / (4.0 * dr.pi),
        )  # fmt: skip

    def scattered(self, w: mi.Vector3f) -> mi.Float:
        """Return roughly what is scattered between ``w``, away from the vertex, and the camera."""
        ahead = dr.dot(w, self.ahead)
        volume = forward_lobe(ahead)
        diffuse = dr.maximum(dr.dot(w, self.n), 0.0)
        glossy = glossy_lobe(dr.dot(w, self.mirrored), self.peaks.x)
        glossy += glossy_lobe(ahead, self.peaks.y)
        return LOBE_MIN + dr.select(self.volume, volume, dr.select(self.diffuse, diffuse, glossy))


PROXY_WORDS = 12


class PackedProxies:
    """Light proxies as rows of twelve numbers, which three loads fetch instead of thirteen."""

    def __init__(self, proxies: LightProxies) -> None:
        """Write the rows; a count of edges is exact as a float32."""
        count = dr.width(proxies.power)
        volume = dr.select(proxies.volume, mi.UInt32(1), 0)
        wide = dr.select(proxies.wide, mi.UInt32(2), 0)
        rest = mi.Float(volume | wide | (proxies.edges << 2))
        self.rows = dr.empty(mi.Float, PROXY_WORDS * count)
        # Flags that are the same for all are known when kernels are compiled.
        self.known = {
            name: flag
            for name, flag in (("volume", proxies.volume), ("wide", proxies.wide))
            if flag.state == dr.VarState.Literal
        }
        words = [
            *proxies.p, proxies.power, *proxies.back, proxies.d_vcm, proxies.d_vc,
            proxies.d_vc_passing, rest, proxies.peak,
        ]  # fmt: skip
        write_row(self.rows, words, dr.arange(mi.UInt32, count))

    def gather(self, index: mi.UInt32, active: mi.Bool | bool = True) -> LightProxies:
        """Return the proxies at ``index``."""
        a, b, c = (dr.gather(mi.Vector4f, self.rows, 3 * index + k, active) for k in range(3))
        rest = mi.UInt32(c.z)
        return LightProxies(
            mi.Point3f(a.x, a.y, a.z), mi.Vector3f(b.x, b.y, b.z), a.w, c.w,
            self.known.get("volume", (rest & 1) > 0), self.known.get("wide", (rest & 2) > 0),
            rest >> 2, b.w, c.x, c.y,
        )  # fmt: skip


def glossy_lobes(
    v: Vertex, mode: mi.TransportMode, active: mi.Bool
) -> list[tuple[mi.Vector3f, mi.Float]]:
    """Return the reflected and the refracted direction at glossy ``v``, and the light of each.

    That is what is scattered there, times pi: 1 for a white diffuse surface seen from above.
    """
    wi = v.frame.to_local(v.wi)
    # The last of the numbers select refraction, where there is any.
    sampled, _ = v.bsdf.sample(
        mi.BSDFContext(mode), surface_interaction(v), mi.Float(1.0 - 1e-6), mi.Point2f(0.5), active
    )
    eta = dr.select(sampled.eta > 0, sampled.eta, 1.0)
    x, y = -wi.x / eta, -wi.y / eta
    z = dr.sqrt(dr.maximum(1.0 - x * x - y * y, 0.0))
    lobes = []
    for local in (
        mi.Vector3f(-wi.x, -wi.y, wi.z), dr.normalize(mi.Vector3f(x, y, -dr.sign(wi.z) * z))
    ):  # fmt: skip
        w = v.frame.to_world(local)
        value = dr.pi * channel_mean(scattering_value(v, w, mode, active))
        lobes.append((w, dr.select(active, dr.clip(value, 0.0, PEAK_MAX), 0.0)))
    return lobes


def glossy_lobe(cosine: mi.Float, peak: mi.Float) -> mi.Float:
    """Return what a glossy lobe scatters, ``peak`` straight into its direction.

    The brighter it is there, the narrower: whatever the roughness, it scatters at most all light.
    """
    return peak * dr.square(dr.rcp(1.0 + GLOSSY_SHARPNESS * peak * (1.0 - cosine)))


def forward_lobe(cosine: mi.Float) -> mi.Float:
    """Return the shape of a forward lobe, 1 straight ahead, like that of milky media."""
    return dr.square(dr.square(0.5 * (1.0 + cosine)))


def proxy_weight(y: LightProxies, z: CameraProxy) -> mi.Float:
    """Return roughly what ``y`` sends to the camera vertex ``z``; at least a little."""
    span = y.p - z.p
    squared = dr.squared_norm(span)
    distance = dr.sqrt(squared)
    inside = y.volume & z.volume
    depth = dr.select(inside, dr.minimum(z.sigma * distance, OPTICAL_DEPTH_MAX), 0.0)
    w = span / dr.maximum(distance, 1e-20)
    transmittance = dr.exp(-depth)
    ahead = dr.dot(w, y.back)
    lobe = dr.select(y.volume, forward_lobe(ahead), glossy_lobe(ahead, y.peak))
    from_y = dr.select(y.wide & ~y.volume, 1.0, LOBE_MIN + lobe)
    from_z = z.scattered(w)
    # Where other strategies find the same light more easily, balance takes 1 / distance^2 away:
    # the lobes are those of a volume, relative to all directions alike.
    to_y, to_z = LOBE_NORM * from_z, LOBE_NORM * from_y
    # A camera subpath that goes on to ``y`` may pass it, if it may pass another one.
    behind = dr.select(z.passes > 1, y.d_vc_passing, dr.select(z.passes == 1, y.d_vc, 0.0))
    others = dr.select(z.terminal, 0.0, to_y * (y.d_vcm + behind * to_z))
    others += to_z * (z.d_vcm + z.d_vc * to_y)
    sent = y.power * transmittance * from_y * from_z
    return sent / dr.clip(squared + transmittance * others, 1e-12, 1e20)


def mirrored_proxy_weight(
    y: LightProxies, a: mi.Point3f, image: mi.Point3f, blur: mi.Float
) -> mi.Float:
    """Return roughly what wide ``y`` sends to ``a`` over mirrors; at least a little.

    ``image`` is that of ``a`` in a likely mirror; of the others only the distance to ``a`` is
    known. ``blur`` (mm^2) is added to squared distances.
    """
    span = y.p - image
    squared = dr.squared_norm(span)
    ahead = dr.dot(span * dr.rsqrt(dr.maximum(squared, 1e-20)), y.back)
    sent = dr.select(y.volume, LOBE_MIN + forward_lobe(ahead), 1.0)
    others = OTHER_MIRRORS / (dr.squared_norm(y.p - a) + blur)
    return y.power * (sent / (squared + blur) + others)


# -- target weights ----------------------------------------------------------------------------


def mirrored_target_weight(
    boxes: MediumBoxes, mirrors: MirrorSet, y: Vertex, a: Vertex, k: mi.UInt32,
    probability: mi.Float, active: mi.Bool,
) -> mi.Float:  # fmt: skip
    """Return the light that ``a`` gets from ``y`` over mirror ``k``, of a selection probability.

    By a perfect mirror of the same reflectance, through the medium at ``y``.
    """
    active = active & (a.weight > 0) & (probability > 0)
    normal, image, selection_weight = mirrors.image(k, a.p, y.p)
    w = image - y.p
    squared = dr.squared_norm(w)
    w *= dr.rsqrt(dr.maximum(squared, 1e-20))
    back = 2.0 * dr.dot(w, normal) * normal - w
    sent = scattering_value(y, w, mi.TransportMode.Importance, active) + MIRRORED_LOBE_MIN
    received = scattering_value(a, back, mi.TransportMode.Radiance, active) + MIRRORED_LOBE_MIN
    light = channel_mean(y.beta * sent * received) * selection_weight * squared
    light = light / _distance_squared(squared, a)
    transmittance = boxes.transmittance(y, image, active)
    return dr.select(active, light * transmittance / probability, 0.0)


def _distance_squared(squared: mi.Float, z: Vertex) -> mi.Float:
    # Connections inside a volume are not brighter than those half a mean free path apart.
    sigma = channel_mean(extinction(z.medium, z.volume)[1])
    near = dr.select(sigma > 0, 0.5 / sigma, 0.0)
    return dr.maximum(squared + dr.square(near), 1e-12)
