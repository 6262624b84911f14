"""What faces do to light: air and paint, the bond of pad and window, the coating and its lobe.

Rough faces are those of Walter et al. 2007 with Beckmann's distribution and the separable Smith
shadowing of Mitsuba's ``roughdielectric``, of which `render.geometry.microfacets` is the vectorized
form. Directions are unit, ``(3,)``, and are turned in place; ``m`` ``(3,)`` is scratch.
"""

from __future__ import annotations

import math

from render.arrays import Array
from render.compiled import inlined
from render.preview.converged.walks.crossings import Block


@inlined
def turn(d: Array, cos: float, azimuth: float) -> None:
    """Turn the unit vector ``d`` by the angle of cosine ``cos`` (frame of Duff et al. 2017)."""
    x, y, z = d[0], d[1], d[2]
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    sin = math.sqrt(max(0.0, 1.0 - cos * cos))
    s, t = sin * math.cos(azimuth), sin * math.sin(azimuth)
    d[0] = s * (1.0 + sign * x * x * a) + t * b + cos * x
    d[1] = s * sign * b + t * (sign + y * y * a) + cos * y
    d[2] = -s * sign * x - t * y + cos * z
    scale = 1.0 / math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    for k in range(3):
        d[k] *= scale


@inlined
def fresnel(cos_in: float, eta: float) -> tuple[float, float]:
    """Return unpolarized reflectance and cosine of refraction; ``eta`` is behind over in front."""
    squared = 1.0 - (1.0 - cos_in * cos_in) / (eta * eta)
    if squared <= 0.0:
        return 1.0, 0.0
    cos_out = math.sqrt(squared)
    s = (cos_in - eta * cos_out) / (cos_in + eta * cos_out)
    p = (eta * cos_in - cos_out) / (eta * cos_in + cos_out)
    return 0.5 * (s * s + p * p), cos_out


@inlined
def unmasked(cos: float, alpha: float) -> float:
    """Return Smith's G1 for Beckmann roughness (Walter 2007, eq. 27)."""
    squared = 1.0 - cos * cos
    if alpha == 0.0 or squared <= 0.0:
        return 1.0
    a = abs(cos) / (alpha * math.sqrt(squared))
    if a >= 1.6:
        return 1.0
    return (3.535 * a + 2.181 * a * a) / (1.0 + 2.276 * a + 2.577 * a * a)


@inlined
def microfacet(d: Array, n: Array, alpha: float, u: float, v: float, m: Array) -> float:
    """Draw a microfacet ``m`` that ``d`` meets; return its weight without shadowing behind it.

    ``n`` is the face's normal on the side that ``d`` comes from; ``m`` has density ``D(m) |m.n|``
    and counts by Walter 2007, eq. 41. 0 where it is met from behind.
    """
    for k in range(3):
        m[k] = n[k]
    if alpha > 0.0:
        cos = 1.0 / math.sqrt(1.0 - alpha * alpha * math.log(1.0 - u))
        turn(m, cos, 2.0 * math.pi * v)
    cos_in = -(d[0] * m[0] + d[1] * m[1] + d[2] * m[2])
    cos_face = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
    cos_micro = m[0] * n[0] + m[1] * n[1] + m[2] * n[2]
    if cos_in <= 0.0 or cos_face <= 1e-9:
        return 0.0
    return float(cos_in * unmasked(cos_face, alpha) / (cos_face * cos_micro))


@inlined
def reflect_inside(
    block: Block, face: int, index: float, d: Array, n: Array, u: float, v: float, chance: float,
    m: Array,
) -> float:  # fmt: skip
    """Turn ``d``, which meets an outer face with inward normal ``n``, back by chance.

    Return its weight; 0 where it leaves. ``index`` is that of the medium before the face; ``u``,
    ``v`` and ``chance`` are random in [0, 1).
    """
    reflectance = block.paint[face, 0]
    if reflectance >= 0.0:
        if chance >= reflectance:
            return 0.0
        if block.paint[face, 1] > 0.0:
            cos_in = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
            for k in range(3):
                d[k] += 2.0 * cos_in * n[k]
        else:
            d[:] = n
            turn(d, math.sqrt(1.0 - u), 2.0 * math.pi * v)
        return 1.0
    alpha = block.alpha[face]
    weight = microfacet(d, n, alpha, u, v, m)
    if weight == 0.0:
        return 0.0
    cos_in = -(d[0] * m[0] + d[1] * m[1] + d[2] * m[2])
    back, _ = fresnel(cos_in, 1.0 / index)
    if chance >= back:
        return 0.0
    for k in range(3):
        d[k] += 2.0 * cos_in * m[k]
    cos_out = d[0] * n[0] + d[1] * n[1] + d[2] * n[2]
    if cos_out <= 0.0:
        return 0.0
    return float(weight * unmasked(cos_out, alpha))


@inlined
def refract_into(
    block: Block, face: int, index: float, d: Array, n: Array, u: float, v: float, m: Array
) -> float:
    """Turn ``d``, which comes from the air, into what has ``index``; return what passes of it.

    ``n`` is the face's outward normal.
    """
    alpha = block.alpha[face]
    weight = microfacet(d, n, alpha, u, v, m)
    if weight == 0.0:
        return 0.0
    cos_in = -(d[0] * m[0] + d[1] * m[1] + d[2] * m[2])
    back, cos_out = fresnel(cos_in, index)
    for k in range(3):
        d[k] = d[k] / index + (cos_in / index - cos_out) * m[k]
    behind = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
    if behind <= 0.0:
        return 0.0
    return weight * (1.0 - back) * unmasked(behind, alpha)


@inlined
def reflect_lobe(block: Block, d: Array, n: Array, u: float, v: float, m: Array) -> float:
    """Turn ``d`` back as the coating's lobe does, ``n`` the normal into the pad; return its weight.

    Microfacets that reflect everything: without the reflectance of the lobe.
    """
    weight = microfacet(d, n, block.skin[2], u, v, m)
    if weight == 0.0:
        return 0.0
    cos_in = -(d[0] * m[0] + d[1] * m[1] + d[2] * m[2])
    for k in range(3):
        d[k] += 2.0 * cos_in * m[k]
    cos_out = d[0] * n[0] + d[1] * n[1] + d[2] * n[2]
    if cos_out <= 0.0:
        return 0.0
    return float(weight * unmasked(cos_out, block.skin[2]))


@inlined
def sent_to(block: Block, d: Array, sight: Array, n: Array) -> float:
    """Return pi f over reflectance for light along ``d`` seen along ``sight``: 1 of Lambert's law.

    Both lead onto the coating, whose normal is ``n`` (Walter et al. 2007, eqs. 20 and 25).
    """
    albedo, specular, alpha = block.skin[0], block.skin[1], block.skin[2]
    cos_in = -(d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
    cos_out = -(sight[0] * n[0] + sight[1] * n[1] + sight[2] * n[2])
    lobe = 0.0
    if cos_in > 1e-9 and cos_out > 1e-9:
        x, y, z = d[0] + sight[0], d[1] + sight[1], d[2] + sight[2]
        cos = x * n[0] + y * n[1] + z * n[2]
        squared = cos * cos / (x * x + y * y + z * z)
        peak = math.exp((1.0 - 1.0 / squared) / (alpha * alpha)) / (alpha * alpha)
        shadowed = unmasked(cos_in, alpha) * unmasked(cos_out, alpha)
        lobe = peak * shadowed / (4.0 * cos_in * cos_out * squared * squared)
    return float((albedo + specular * lobe) / (albedo + specular))


@inlined
def index_of(block: Block, below: bool) -> float:
    """Return the index of the window, where ``below``, or of the pad."""
    return block.window if below else block.index


@inlined
def meet_bond(block: Block, below: bool, d: Array, chance: float) -> bool:
    """Refract ``d`` at the smooth bond of pad and window, or reflect it by chance.

    Return whether it is ``below`` the bond afterwards. Powers of photons stay what they are; so do
    the weights of paths that follow light backwards, which stand for radiance over the index
    squared (Veach 1997, eq. 5.3).
    """
    eta = index_of(block, not below) / index_of(block, below)
    back, cos_out = fresnel(abs(d[2]), eta)
    if chance < back:
        d[2] = -d[2]
        return below
    d[0] /= eta
    d[1] /= eta
    d[2] = math.copysign(cos_out, d[2])
    return not below
