"""The slab response of a scene, made once per material and kept in the user's cache."""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from render.errors import RenderError, TableError
from render.files import read_npz, write_npz
from render.geometry import flat_fiber_poses
from render.preview.diffuser.emission import FiberEnd
from render.preview.diffuser.random_walk import Slab
from render.preview.diffuser.response import OPAQUE_THICKNESS, RAYS, SlabResponse, compute_response
from render.scene import Edge, Scene

VERSION = 4
"""Part of the cache key: raise it when the walk, the basis or the file changes."""


def slab_response(
    scene: Scene,
    fiber_end: FiberEnd | None = None,
    *,
    edge: Edge = "left",
    cache: Path | None = None,
    rays: int = RAYS,
) -> SlabResponse:
    """Return the response of the scene's diffuser on ``edge``, from the cache or made now.

    ``fiber_end`` shines on it; None: the scene's fibers, which are all alike. ``cache`` is by
    default in ``$XDG_CACHE_HOME/tactilux``; ``rays`` light paths are followed.
    """
    slab, fiber_end = slab_of(scene, edge), fiber_end or fiber_end_of(scene)
    layer = {name: value for name, value in asdict(slab).items() if value is not None}
    content = {"version": VERSION, "rays": rays, "slab": layer, "beam": _beam(fiber_end)}
    key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
    path = (cache or cache_folder()) / f"slab-{key}.npz"
    if path.exists():
        try:
            return _read(path)
        except TableError as error:
            warnings.warn(f"{error}; it is made again", stacklevel=2)
    response = compute_response(slab, fiber_end, rays=rays)
    try:
        write_npz(path, {name: np.asarray(value) for name, value in vars(response).items()})
    except OSError as error:
        warnings.warn(f"the slab response cannot be cached: {error}", stacklevel=2)
    return response


def hides_lamps(scene: Scene) -> bool:
    """Return whether the diffuser is opaque between the pad and all lamps before it or in it."""
    milky = flat_fiber_poses(scene).milky
    before = milky[milky > 0.0].min(initial=slab_of(scene).thickness)
    return slab_of(scene).optical_depth(float(before)) >= OPAQUE_THICKNESS


def slab_of(scene: Scene, edge: Edge = "left") -> Slab:
    """Return the layer on ``edge`` of a scene that has one."""
    if scene.diffuser is None:
        raise RenderError("the scene has no diffuser, so it has no slab response", field="diffuser")
    plain = scene.pad.roughness
    outer, lower = scene.finish(edge).roughness, scene.finish("lower").roughness
    return Slab(
        thickness=scene.diffuser.thickness,
        height=scene.pad.thickness,
        sigma_s=scene.diffuser.sigma_s,
        sigma_a=scene.diffuser.sigma_a,
        g=scene.diffuser.g,
        index=scene.pad.index,
        roughness=plain,
        outer=None if outer == plain else outer,
        lower=None if lower == plain else lower,
    )


def fiber_end_of(scene: Scene) -> FiberEnd:
    """Return the end of the first lamp: that of all fibers, which are alike."""
    return fiber_ends(scene)[0]


def fiber_ends(scene: Scene) -> list[FiberEnd]:
    """Return the ends of all lamps, as seen from the faces that they shine through."""
    if scene.fibers is not None and not scene.lamps:
        row = scene.fibers.rows()[0]
        return [FiberEnd(row.diameter, row.gap, row.height, row.tilt, row.profile)] * len(
            scene.turning
        )
    gap = flat_fiber_poses(scene).gap
    return [
        FiberEnd(
            lamp.diameter, round(float(gap[i]), 9), float(lamp.position[2]), lamp.tilt, lamp.profile
        )
        for i, lamp in enumerate(scene.placed_lamps())
    ]


def _beam(end: FiberEnd) -> dict[str, Any]:
    """Return what the response depends on; a Gaussian's sigma_v stands beside the rest."""
    kept = {name: getattr(end, name) for name in ("diameter", "gap", "height", "tilt")}
    return kept | end.profile.model_dump(exclude_none=True)


def cache_folder() -> Path:
    """Return the folder for files that can be made again."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "tactilux"


def _read(path: Path) -> SlabResponse:
    """Return the response stored in ``path``.

    Raises:
        TableError: when the file is damaged or holds something else.
    """
    arrays = read_npz(path, sealed=True)
    names = [field.name for field in fields(SlabResponse)]
    if set(arrays) != {*names}:
        raise TableError(f"{path} is not a slab response", field="slab")
    phi, offsets, heights, radiance, albedo = (arrays[name] for name in names)
    return SlabResponse(phi, offsets, heights, radiance, float(albedo))
