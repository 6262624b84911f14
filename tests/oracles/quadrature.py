"""Direct light of a lamp by quadrature: the closed form of a coating that nothing covers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import quad

from render.geometry import camera_origin, facet_masks, facets, pixel_directions
from render.scene import Scene
from tests.oracles.analog_tracer import Lamp


def irradiance(
    point: np.ndarray,
    normal: np.ndarray,
    source: Lamp,
    passed: Callable[[np.ndarray], np.ndarray] = np.ones_like,
) -> np.ndarray:
    """Return power per area at ``point`` ``(..., 3)`` in 1/mm^2 by quadrature over the lamp.

    ``passed`` is what is left on the way of light whose ``|cosine|`` to z it is given.
    """
    flux, _ = quad(
        lambda t: np.exp(-((t / (2 * source.sigma_v)) ** 2)) * np.cos(t) * np.sin(t), 0, np.pi / 2
    )
    peak = 1 / (2 * np.pi * flux) / (np.pi * source.radius**2)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    total = np.zeros(point.shape[:-1])
    for u, w in zip(0.5 + 0.5 * nodes, 0.5 * weights, strict=True):
        for at in 2 * np.pi * (np.arange(16) + 0.5) / 16:
            r = source.radius * np.sqrt(u)
            place = source.center + source.frame @ [r * np.cos(at), r * np.sin(at), 0.0]
            span = point - place
            distance = np.linalg.norm(span, axis=-1)
            off = np.clip(span @ source.frame[:, 2] / distance, -1, 1)
            arriving = np.maximum(-(span @ normal) / distance, 0) * np.maximum(off, 0)
            radiance = peak * np.exp(-((np.arccos(off) / (2 * source.sigma_v)) ** 2))
            arriving = arriving * passed(np.abs(span[..., 2]) / distance)
            total += w / 16 * np.pi * source.radius**2 * radiance * arriving / distance**2
    return total


def facet_radiance(scene: Scene, bend: float, source: Lamp) -> np.ndarray:
    """Return what the pixels of each pressed facet see, ``(site * facet,)``, without shadows.

    In 1/(mm^2 sr) at the scene's albedo, which has to be small: light that comes back is left out.
    """
    masks, place, origin = facet_masks(scene, bend), facets(scene, bend), camera_origin(scene)
    radiance = []
    for site in range(scene.sites.count):
        for facet in range(scene.indenter.faces):
            pixels = masks.of(site, facet)
            rays = pixel_directions(
                scene, masks.columns, masks.rows,
                pixels % masks.columns + 0.5, pixels // masks.columns + 0.5,
            )  # fmt: skip
            corner, normal = place.corners[site, facet, 0], place.normal[site, facet]
            points = origin + rays * ((corner - origin) @ normal / (rays @ normal))[:, None]
            radiance.append(irradiance(points, normal, source).mean())
    return scene.coating.albedo / np.pi * np.array(radiance)
