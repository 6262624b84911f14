"""Mesh files of others: bodies that are pressed in, and the solids of skins."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import trimesh


def read_mesh(path: Path) -> trimesh.Trimesh:
    """Return the mesh of an STL, PLY or OBJ file, in its units.

    Raises:
        ValueError: a sentence that names the file; it is none, or has no triangles.
    """
    import trimesh  # only for scenes and pictures with such a file

    if not path.is_file():
        raise ValueError(f"{path} is no body: there is no such file, allowed: one beside the scene")
    try:
        with np.errstate(invalid="ignore", over="ignore"):  # far corners are refused elsewhere
            mesh = trimesh.load_mesh(path)
        if not len(mesh.triangles) or not np.isfinite(mesh.triangles).all():
            raise ValueError("no triangles")
    except Exception:  # readers raise what they like
        raise ValueError(
            f"{path} is no body that can be read, allowed: a mesh file in mm, such as STL, PLY or "
            "OBJ"
        ) from None
    return mesh
