"""Mesh files of others: bodies that are pressed in, and the solids of skins; and their units.

STL, PLY and OBJ files hold numbers without a unit; some name one in a remark, and by custom it is
mm. A body whose size in mm fits no pad is in another unit.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from render.files import MEGABYTE, read_bytes
from render.mesh_units import NAMES, UNITS, Unit

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import ArrayLike

    from render.arrays import Array

KINDS = (".stl", ".ply", ".obj")
MOST_BYTES = 64 * MEGABYTE
"""Of a mesh file: a million triangles of a binary STL file."""
COMMON, RARE, USUAL = 20.0, 10.0, 5.0
"""How many times larger or smaller than the pad a body may be in mm, in other units, and without a
word of other units."""
_REMARK = re.compile(
    r"(?im)^(?:\s*(?:#|comment|obj_info)|solid).*\bunits?\b[^\w\n]*"
    # "units in mm" are no inches, "units: in" are.
    r"(?:(?:are|is|of|in(?=[^\w\n]+[a-z]))[^\w\n]+)*([a-z]+)"
)


def read_mesh(path: Path) -> tuple[trimesh.Trimesh, Unit | None]:
    """Return the mesh of an STL, PLY or OBJ file, in its unit, and that unit if a remark names it.

    Nothing else that the file names is opened: no materials, no pictures.

    Raises:
        ValueError: a sentence that names the file; it is none, too large, or has no triangles.
    """
    import trimesh  # only for scenes and pictures with such a file

    if not path.is_file():
        raise ValueError(f"{path} is no body: there is no such file, allowed: one beside the scene")
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise ValueError(f"{path} is no body: it ends in {kind!r}, allowed: {', '.join(KINDS)}")
    try:
        content = read_bytes(path, MOST_BYTES)
    except OSError as error:
        raise ValueError(f"{path} is no body: {error.strerror}, allowed: a smaller mesh") from None
    try:
        with np.errstate(invalid="ignore", over="ignore"):  # far corners are refused elsewhere
            mesh = trimesh.load_mesh(io.BytesIO(content), file_type=kind[1:])
        if not len(mesh.triangles) or not np.isfinite(mesh.triangles).all():
            raise ValueError("no triangles")
    except Exception:  # readers raise what they like
        raise ValueError(
            f"{path} is no body that can be read, allowed: a mesh file in STL, PLY or OBJ"
        ) from None
    remark = _REMARK.search(content[:4096].decode("latin-1"))
    named = None if remark is None else NAMES.get(remark[1].lower().removesuffix("s"))
    return mesh, named


def unit_of_body(extents: ArrayLike, pad: float) -> Unit:
    """Return the unit that a pressed body of ``extents`` ``(3,)`` is in, by its size.

    mm where it is up to `COMMON` times larger or smaller than the ``pad``, mm; else the only unit
    in which it is up to `RARE` times so.

    Raises:
        ValueError: a phrase with the sizes that it may have.
    """
    size = float(np.max(extents))
    if pad / COMMON <= size <= pad * COMMON:
        return "mm"
    fitting = [unit for unit, mm in UNITS.items() if pad / RARE <= size * mm <= pad * RARE]
    if len(fitting) == 1:
        return fitting[0]
    sizes = ", ".join(f"{unit} ({size * mm:.4g} mm)" for unit, mm in UNITS.items())
    raise ValueError(f"does not say its unit, and is {size:.3g} of it in size: give unit, {sizes}")


def unit_of_outline(sides: Array, pad: tuple[float, float] | None) -> Unit:
    """Return the unit in which ``sides`` ``(2,)`` are nearest to those of the ``pad``, mm."""
    if pad is None or not (np.asarray(sides) > 0).all() or min(pad) <= 0:
        return "mm"
    return min(UNITS, key=lambda unit: float(np.abs(np.log(sides * UNITS[unit] / pad)).max()))


def size_in_words(extents: ArrayLike, unit: Unit, pad: float) -> str:
    """Return the size of a body of ``extents`` ``(3,)``, and units in which it would fit better."""
    sides = " x ".join(f"{side * UNITS[unit]:.3g}" for side in np.asarray(extents))
    size = float(np.max(extents))
    misfit = {one: float(abs(np.log(size * mm / pad))) for one, mm in UNITS.items()}
    nearer = [one for one in UNITS if misfit[one] < misfit[unit] > np.log(USUAL)]
    others = ", ".join(f"{size * UNITS[one]:.3g} if in {one}" for one in nearer)
    return f"{sides} mm in {unit}" + (f" ({others})" if others else "")
