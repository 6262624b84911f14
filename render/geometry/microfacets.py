"""Light at a rough dielectric face, sampled with numpy: Fresnel, Snell and a Beckmann surface.

Walter et al. 2007, "Microfacet models for refraction through rough surfaces", with the separable
Smith shadowing that Mitsuba's ``roughdielectric`` uses, so that both levels share one model.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
"""float32 for photons, float64 for geometry."""


class FaceSample(NamedTuple):
    """What becomes of photons at a face; directions ``(photon, 3)``, the rest ``(photon,)``.

    ``reflection`` and ``transmission`` are weights that include the Fresnel factor; they are 0
    where the microfacet sends the light to the wrong side.
    """

    reflected: Floats
    reflection: Floats
    refracted: Floats
    transmission: Floats


def fresnel(cos_in: Floats, eta: float) -> tuple[Floats, Floats]:
    """Return the unpolarized reflectance and ``cos`` of refraction, both ``(...)``.

    ``cos_in`` >= 0 is the cosine of incidence, ``eta`` the index behind the face over the index in
    front. Under total internal reflection the reflectance is 1 and the cosine 0.
    """
    squared = 1 - (1 - cos_in**2) / eta**2
    cos_out = np.sqrt(np.maximum(squared, 0))
    with np.errstate(invalid="ignore"):
        s = (cos_in - eta * cos_out) / (cos_in + eta * cos_out)
        p = (eta * cos_in - cos_out) / (eta * cos_in + cos_out)
    reflectance = np.where(squared > 0, 0.5 * (s**2 + p**2), 1.0)
    return np.nan_to_num(reflectance, nan=1.0).astype(cos_in.dtype), cos_out


def shadowing(cos: Floats, alpha: float) -> Floats:
    """Return Smith's G1 for Beckmann roughness (Walter 2007, eq. 27) at ``|cos|`` to the face."""
    if alpha == 0.0:
        return np.ones_like(cos)
    cos = np.clip(np.abs(cos), 1e-6, 1)
    a = cos / (alpha * np.sqrt(np.maximum(1 - cos**2, 1e-12)))
    rational = (3.535 * a + 2.181 * a**2) / (1 + 2.276 * a + 2.577 * a**2)
    return np.where(a < 1.6, rational, 1.0).astype(cos.dtype)


def sample_rough_face(
    direction: Floats, axis: int, alpha: float, eta: float, rng: np.random.Generator
) -> FaceSample:
    """Send photons through the face that is normal to ``axis``, whichever way they come.

    Arguments:
        direction: ``(photon, 3)`` unit vectors, not parallel to the face.
        axis: 0, 1 or 2, the coordinate along the face's normal.
        alpha: Beckmann roughness; 0 is a smooth face.
        eta: refractive index behind the face divided by the index in front.
        rng: where the microfacets come from.
    """
    n = len(direction)
    # The normal that faces the incoming light has the sign opposite to the direction's.
    side = -np.sign(direction[:, axis])
    micro = np.zeros_like(direction)
    # Slopes of a Beckmann surface are Gaussian with variance alpha^2 / 2 each.
    if alpha > 0:
        for other in {0, 1, 2} - {axis}:
            micro[:, other] = np.float32(alpha / np.sqrt(2)) * rng.standard_normal(
                n, dtype=np.float32
            )
    micro[:, axis] = side
    micro /= np.linalg.norm(micro, axis=-1, keepdims=True)
    cos_face = np.abs(direction[:, axis])
    cos_in = -np.einsum("ij,ij->i", direction, micro)
    faces = cos_in > 0
    cos_in = np.maximum(cos_in, 1e-6)
    reflectance, cos_out = fresnel(cos_in, eta)
    # Walter 2007, eq. 41, for normals drawn from D(m) |m.n|.
    weight = (
        cos_in * shadowing(cos_face, alpha) / (np.maximum(cos_face, 1e-6) * np.abs(micro[:, axis]))
    )
    weight = np.where(faces, weight, 0)
    reflected = direction + (2 * cos_in)[:, None] * micro
    refracted = direction / np.float32(eta) + (cos_in / np.float32(eta) - cos_out)[:, None] * micro
    back = reflected[:, axis] * side > 0
    through = refracted[:, axis] * side < 0
    reflection = weight * reflectance * shadowing(reflected[:, axis], alpha)
    transmission = weight * (1 - reflectance) * shadowing(refracted[:, axis], alpha)
    return FaceSample(
        reflected,
        np.where(back, reflection, 0).astype(np.float32),
        refracted,
        np.where(through, transmission, 0).astype(np.float32),
    )
