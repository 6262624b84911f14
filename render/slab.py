"""The slab response: the diffuser as a secondary light, made once per material and cached.

Each fiber makes a spot glow on the inner face of the diffuser. The response holds that glow as a
few point lights per fiber, each with a low-order directional distribution, as a function of phi.
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from render.bending import Array
from render.chebyshev import chebyshev_nodes, interpolation_weights
from render.errors import RenderError, TableError
from render.scene import Scene
from render.slab_launch import Beam, launch, launch_diffuse
from render.slab_walk import Photons, Slab, walk
from render.transport import read_npz, write_npz

VERSION = 1
"""Part of the cache key: raise it when the walk or the basis changes."""
PHI_NODES, HEIGHTS, TERMS = 11, 3, 9
MIRROR_ALONG = np.array([1, -1, 1, 1, -1, 1, 1, -1, 1])
"""Signs of the terms when the direction along the edge is reversed."""
LEVELS = (0.0, 0.36, 0.66, 0.88, 0.98)
"""Parts of the light within each offset along the edge."""
RAYS, BATCH, DIFFUSE_RAYS = 360_000, 60_000, 30_000
LEAST_STEP = 1e-3
"""Least distance (mm) between offsets."""
LEAST_POWER = 1e-6
"""Part of a fiber's light that must pass the diffuser: with less, noise is all there is."""
EVENTS = 20_000_000
"""Scattering and reflection events after which no further batch is started."""


@dataclass(frozen=True)
class SlabResponse:
    """What one fiber of unit power makes of the diffuser's inner face.

    Arguments:
        phi: ``(node,)`` rad, Chebyshev points on [0, pi].
        offsets: ``(offset,)`` mm along the edge from the fiber, ascending, symmetric.
        heights: ``(height,)`` mm above the camera-side face, Gauss points.
        radiance: ``(node, offset, height, term)`` in 1/sr: the area-integrated radiance of each
            point light is the sum over `directional_terms`; its intensity is that times the
            cosine to the face.
        albedo: part of diffuse light that comes back when it enters through the inner face.
    """

    phi: Array
    offsets: Array
    heights: Array
    radiance: Array
    albedo: float

    def at(self, phi: Array) -> Array:
        """Return ``radiance`` at directions ``phi`` ``(...)`` rad: ``(..., offset, height, term)``."""
        weights = interpolation_weights(self.phi, phi)
        return np.einsum("...j,jozt->...ozt", weights, self.radiance)

    def power(self, phi: Array) -> Array:
        """Return the power ``(...)`` that leaves through the inner face."""
        return np.asarray(self.at(phi).sum(axis=(-3, -2)) @ _moments()[0])


def directional_terms(direction: Array) -> Array:
    """Return ``1, a, z, a^2, a z, z^2, d, d a, d z`` ``(..., 9)`` of unit vectors ``(a, d, z)``.

    They span the spherical harmonics up to degree 2: along the edge, into the pad, upwards.
    """
    a, d, z = direction[..., 0], direction[..., 1], direction[..., 2]
    one = np.ones_like(a)
    return np.stack([one, a, z, a * a, a * z, z * z, d, d * a, d * z], axis=-1)


def slab_response(scene: Scene, *, cache: Path | None = None) -> SlabResponse:
    """Return the response for the scene's diffuser and fibers, from the cache or made now.

    Arguments:
        scene: must have a diffuser.
        cache: folder of the cache; by default ``$XDG_CACHE_HOME/tactilux``.
    """
    slab, beam = _slab(scene), _beam(scene)
    content = {"version": VERSION, "rays": RAYS, "slab": asdict(slab), "beam": asdict(beam)}
    key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
    path = (cache or cache_folder()) / f"slab-{key}.npz"
    if path.exists():
        try:
            return _read(path)
        except TableError as error:
            warnings.warn(f"{error}; it is made again", stacklevel=2)
    response = compute_response(slab, beam)
    try:
        write_npz(path, _arrays(response) | {"checksum": np.str_(_checksum(response))})
    except OSError as error:
        warnings.warn(f"the slab response cannot be cached: {error}", stacklevel=2)
    return response


def cache_folder() -> Path:
    """Return the folder for files that can be made again."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "tactilux"


def compute_response(slab: Slab, beam: Beam, *, rays: int = RAYS, seed: int = 0) -> SlabResponse:
    """Return the response from a random walk of ``rays`` photons over all phi nodes."""
    rng = np.random.default_rng(seed)
    phi = chebyshev_nodes(PHI_NODES, 0.0, np.pi)
    heights = slab.height * 0.5 * (np.polynomial.legendre.leggauss(HEIGHTS)[0] + 1)
    leaving: list[tuple[Photons, Array]] = []
    launched = events = 0
    while launched < rays and events < EVENTS:
        photons, weight = launch(slab, beam, phi, BATCH, rng)
        left, spent = walk(slab, photons, rng)
        leaving.append((left, left.weight[:, None] * weight[left.label]))
        launched, events = launched + BATCH, events + spent
    passed = max(float(power.sum(axis=0).max()) for _, power in leaving)
    if passed < LEAST_POWER:
        raise RenderError(
            f"the diffuser lets only {passed:.1e} of the light through, allowed: at least "
            f"{LEAST_POWER:g}; make it thinner, less absorbing, or bring the fibers nearer",
            field="diffuser",
            value=passed,
            allowed=f"at least {LEAST_POWER:g}",
        )
    offsets = _offsets(leaving)
    deposits = [_deposit(left, power, offsets, heights) for left, power in leaving]
    back, _ = walk(slab, launch_diffuse(slab, DIFFUSE_RAYS, rng), rng)
    return SlabResponse(
        phi, offsets, heights, _symmetric(np.mean(deposits, axis=0)), float(back.weight.sum())
    )


def _offsets(leaving: list[tuple[Photons, Array]]) -> Array:
    """Return points along the edge that share the light of all nodes by `LEVELS`."""
    away = np.concatenate([np.abs(left.position[:, 0]) for left, _ in leaving])
    power = np.concatenate([power.sum(axis=1) for _, power in leaving])
    order = np.argsort(away)
    half = np.interp(LEVELS, np.cumsum(power[order]) / power.sum(), away[order])
    # Points must stay apart even when a clear layer keeps all light in one spot.
    half = np.maximum.accumulate(half + LEAST_STEP * np.arange(len(half))) - half[0]
    return np.concatenate([-half[:0:-1], half])


def _deposit(left: Photons, power: Array, offsets: Array, heights: Array) -> Array:
    """Project photons onto the basis: ``(node, offset, height, term)``.

    Along the edge linear weights, upwards Lagrange weights (exact for quadratic light paths), over
    directions the least-squares radiance, whose normal equations are the moments of the terms.
    """
    position = left.position.astype(np.float64)
    along = linear_weights(position[:, 0], offsets)
    up = interpolation_weights(heights, position[:, 2])
    directional = directional_terms(left.direction.astype(np.float64))
    directional = np.linalg.solve(_moments(), directional.T).T
    basis = up[:, :, None] * directional[:, None]
    return np.stack(
        [np.einsum("pj,pzt->jzt", power * weight[:, None], basis, optimize=True)
         for weight in along.T],
        axis=1,
    )


def linear_weights(x: Array, nodes: Array) -> Array:
    """Return ``(x, node)`` weights that share ``x`` between its neighbours; ends hold the rest."""
    cell = np.clip(np.searchsorted(nodes, x) - 1, 0, len(nodes) - 2)
    part = np.clip((x - nodes[cell]) / (nodes[cell + 1] - nodes[cell]), 0.0, 1.0)
    weights = np.zeros((len(x), len(nodes)))
    rows = np.arange(len(x))
    weights[rows, cell] = 1 - part
    weights[rows, cell + 1] = part
    return weights


def _moments() -> Array:
    """Return the integrals ``(9, 9)`` of products of terms times the cosine over the hemisphere."""
    cosine, weight = np.polynomial.legendre.leggauss(8)
    cosine, weight = 0.5 * (cosine + 1), 0.5 * weight
    azimuth = 2 * np.pi * np.arange(16) / 16
    sin = np.sqrt(1 - cosine**2)[:, None]
    direction = np.stack(
        np.broadcast_arrays(sin * np.cos(azimuth), cosine[:, None], sin * np.sin(azimuth)), axis=-1
    )
    terms = directional_terms(direction)
    return np.einsum("c,cak,cal->kl", weight * cosine * 2 * np.pi / 16, terms, terms)


def _symmetric(radiance: Array) -> Array:
    """Average with the mirror image: phi and pi - phi, along and against the edge."""
    return np.asarray(0.5 * (radiance + MIRROR_ALONG * radiance[::-1, ::-1]))


def _slab(scene: Scene) -> Slab:
    if scene.diffuser is None:
        raise RenderError("the scene has no diffuser, so it has no slab response", field="diffuser")
    return Slab(
        thickness=scene.diffuser.thickness,
        height=scene.pad.thickness,
        sigma_s=scene.diffuser.sigma_s,
        sigma_a=scene.diffuser.sigma_a,
        g=scene.diffuser.g,
        index=scene.pad.index,
        roughness=scene.pad.roughness,
    )


def _beam(scene: Scene) -> Beam:
    fibers = scene.fibers
    return Beam(fibers.diameter, fibers.gap, fibers.height, fibers.sigma_v, fibers.tilt)


def _arrays(response: SlabResponse) -> dict[str, np.ndarray]:
    return {name: np.asarray(value) for name, value in vars(response).items()}


def _checksum(response: SlabResponse) -> str:
    digest = hashlib.sha256()
    for array in _arrays(response).values():
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _read(path: Path) -> SlabResponse:
    """Return the response stored in ``path``.

    Raises:
        TableError: when the file is damaged or holds something else.
    """
    arrays = read_npz(path)
    names = [field.name for field in fields(SlabResponse)]
    if set(arrays) != {*names, "checksum"}:
        raise TableError(f"{path} is not a slab response", field="slab")
    stored = {name: arrays[name] for name in names}
    response = SlabResponse(**{**stored, "albedo": float(stored["albedo"])})
    if _checksum(response) != str(arrays["checksum"]):
        raise TableError(f"{path} is damaged", field="slab")
    return response
