"""The slab response of a scene, made once per material and kept in the user's cache."""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from render.errors import RenderError, TableError
from render.files import read_npz, write_npz
from render.preview.diffuser.emission import FiberEnd
from render.preview.diffuser.random_walk import Slab
from render.preview.diffuser.response import RAYS, SlabResponse, compute_response
from render.scene import Scene

VERSION = 3
"""Part of the cache key: raise it when the walk or the basis changes."""


def slab_response(scene: Scene, *, cache: Path | None = None, rays: int = RAYS) -> SlabResponse:
    """Return the response for the scene's diffuser and fibers, from the cache or made now.

    Arguments:
        scene: must have a diffuser.
        cache: folder of the cache; by default ``$XDG_CACHE_HOME/tactilux``.
        rays: light paths that are followed.
    """
    slab, fiber_end = slab_of(scene), fiber_end_of(scene)
    content = {"version": VERSION, "rays": rays, "slab": asdict(slab), "beam": asdict(fiber_end)}
    key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
    path = (cache or cache_folder()) / f"slab-{key}.npz"
    if path.exists():
        try:
            return _read(path)
        except TableError as error:
            warnings.warn(f"{error}; it is made again", stacklevel=2)
    response = compute_response(slab, fiber_end, rays=rays)
    try:
        write_npz(path, _arrays(response) | {"checksum": np.array(_checksum(response))})
    except OSError as error:
        warnings.warn(f"the slab response cannot be cached: {error}", stacklevel=2)
    return response


def slab_of(scene: Scene) -> Slab:
    """Return the layer of a scene that has one."""
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


def fiber_end_of(scene: Scene) -> FiberEnd:
    """Return the fiber ends of a scene."""
    fibers = scene.fibers
    return FiberEnd(fibers.diameter, fibers.gap, fibers.height, fibers.sigma_v, fibers.tilt)


def cache_folder() -> Path:
    """Return the folder for files that can be made again."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "tactilux"


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
    phi, offsets, heights, radiance, albedo = (arrays[name] for name in names)
    response = SlabResponse(phi, offsets, heights, radiance, float(albedo))
    if _checksum(response) != str(arrays["checksum"]):
        raise TableError(f"{path} is damaged", field="slab")
    return response
