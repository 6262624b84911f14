"""The lobe of a skin by analog photons: what a camera gets that no tally of irradiance tells.

A Lambertian skin sends the same radiance everywhere, so power per area is enough
(``tests.oracles.analog_cells``). The radiance of a lobe depends on where light comes from and on
where it is seen from. So each photon that arrives is paired with lines of sight that end in the
same small bin of the skin, and counts there by the value of the lobe between both:

    L(ray) = albedo / pi E(bin) + 1 / A(bin) sum over photons in it of power f(photon, ray).

The lobe is that of microfacets that reflect everything: Beckmann's distribution and separable Smith
shadowing (Walter et al. 2007, eqs. 20, 25 and 27), times the skin's reflectance. Photons take it as
they take rough faces.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.oracles.analog_tracer import (
    COATING,
    ENDS,
    MICROFACETS,
    Floats,
    Lamp,
    Pad,
    arrive,
    compiled,
    emit,
    enter_pad,
    lambertian,
    smith,
    tally_bin,
    uniform,
)
from tests.oracles.mesh_tracer import meet_tilted_face

ALL_REFLECTED = 1e-9
"""Relative index of what reflects everything."""
PAIRS = 4
"""Lines of sight that a photon is paired with where it arrives."""


class Sights(NamedTuple):
    """Lines of sight by the bin that they end in: those of ``b`` are ``first[b]:first[b + 1]``.

    ``direction (ray, 3)`` towards the skin, ``weight (ray,)`` and ``target (ray,)``.
    """

    first: NDArray[np.int64]
    direction: Floats
    weight: Floats
    target: NDArray[np.int64]


def sights_by_bin(
    bins: NDArray[np.int64], arrived: Floats, weight: Floats, target: NDArray[np.int64], count: int
) -> Sights:
    """Return the lines of sight that get to the skin, sorted into its ``count`` bins."""
    order = np.argsort(bins, kind="stable")
    order = order[weight[order] > 0.0]
    first = np.searchsorted(bins[order], np.arange(count + 1))
    return Sights(first, arrived[order], weight[order], target[order])


@compiled
def lobe_value(d: Floats, view: Floats, n: Floats, alpha: float) -> float:
    """Return the lobe's BRDF (1/sr) for light along ``d`` seen along ``view``, both onto the skin.

    ``n`` is the skin's normal, against both.
    """
    cos_d = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
    cos_view = -(view[0] * n[0] + view[1] * n[1] + view[2] * n[2])
    if cos_d <= 0.0 or cos_view <= 0.0:
        return 0.0
    x, y, z = d[0] + view[0], d[1] + view[1], d[2] + view[2]
    cos = -(x * n[0] + y * n[1] + z * n[2]) / math.sqrt(x * x + y * y + z * z)
    squared = cos * cos
    density = math.exp((1.0 - 1.0 / squared) / alpha**2) / (math.pi * alpha**2 * squared**2)
    return density * smith(cos_d, alpha) * smith(cos_view, alpha) / (4.0 * cos_d * cos_view)


@compiled
def leave_skin(
    state: NDArray[np.uint64], pad: Any, d: Floats, n: Floats, weight: float, ends: Floats
) -> float:
    """Turn a photon back at the skin by chance; return its weight, 0 where it ends there.

    ``pad`` is a ``Pad`` or a ``MeshPad``.
    """
    number = uniform(state)
    if number < pad.albedo:
        lambertian(state, d, n)
        return weight
    if number >= pad.albedo + pad.specular:
        ends[COATING] += weight
        return 0.0
    left, _ = meet_tilted_face(state, d, n, pad.lobe, ALL_REFLECTED)
    ends[MICROFACETS] += weight * (1.0 - left)
    return weight * left


@compiled
def show(
    state: NDArray[np.uint64], pad: Any, sights: Sights, here: int, area: float, d: Floats,
    n: Floats, weight: float, seen: Floats,
) -> None:  # fmt: skip
    """Add to ``seen`` ``(target,)`` what lines of sight to bin ``here`` see of a photon there."""
    begin, rays = sights.first[here], sights.first[here + 1] - sights.first[here]
    if rays == 0:
        return
    for _ in range(PAIRS):
        ray = begin + min(rays - 1, int(uniform(state) * rays))
        value = lobe_value(d, sights.direction[ray], n, pad.lobe)
        value *= pad.specular * weight * sights.weight[ray] * rays
        seen[sights.target[ray]] += value / (PAIRS * area)


@compiled
def trace_sights(
    pad: Pad, origin: Floats, directions: Floats, seed: int
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Return bin ``(ray,)``, direction ``(ray, 3)`` and weight ``(ray,)`` at the skin.

    ``origin (3,)`` in the air, ``directions (ray, 3)``; weight 0 where a ray does not get there.
    """
    state = np.full(1, seed, dtype=np.uint64) * np.uint64(0xD1342543DE82EF95)
    p, d, ends = np.zeros(3), np.zeros(3), np.zeros(ENDS)
    count = directions.shape[0]
    bins, arrived, weights = np.zeros(count, np.int64), np.zeros((count, 3)), np.zeros(count)
    for ray in range(count):
        p[:] = origin
        d[:] = directions[ray]
        weight, site, facet = enter_pad(state, pad, p, d, ends), -1, -1
        if weight > 0.0:
            weight, site, facet = arrive(state, pad, p, d, weight, ends)
        if weight > 0.0:
            bins[ray], weights[ray] = tally_bin(pad, p, site, facet), weight
            arrived[ray] = d
    return bins, arrived, weights


@compiled
def trace_photons_to_sights(
    pad: Pad, lamp: Lamp, count: int, seed: int, area: Floats, sights: Sights, targets: int
) -> tuple[Floats, Floats, Floats]:
    """Return power per bin ``(bin,)``, light by the lobe ``(target,)``, and where power ends.

    ``count`` photons share the lamp's power of 1. The second is the sum over lines of sight of
    weight times radiance.
    """
    state = np.full(1, seed, dtype=np.uint64) * np.uint64(0xD1342543DE82EF95)
    tally, seen, ends = np.zeros(len(area)), np.zeros(targets), np.zeros(ENDS)
    p, d, n = np.zeros(3), np.zeros(3), np.zeros(3)
    down = np.array([0.0, 0.0, -1.0])
    for _ in range(count):
        emit(state, lamp, p, d)
        weight = enter_pad(state, pad, p, d, ends)
        while weight > 0.0:
            weight, site, facet = arrive(state, pad, p, d, weight, ends)
            if weight == 0.0:
                break
            n[:] = down if site < 0 else pad.normal[facet]
            here = tally_bin(pad, p, site, facet)
            tally[here] += weight
            show(state, pad, sights, here, area[here], d, n, weight, seen)
            weight = leave_skin(state, pad, d, n, weight, ends)
    return tally / count, seen / count, ends / count
