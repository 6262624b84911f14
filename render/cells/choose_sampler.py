"""Which estimator renders the cells of a pad, and which pads none does.

Chosen before Mitsuba is loaded, so that renders can be planned and refused without it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from render.errors import RenderError
from render.geometry import in_state
from render.pad import mirror_faces
from render.scene import FACES, Scene

STRATA = 4
"""Camera subpaths of a facet in one sample, each from its own part of the facet's pixels."""
TRAPPED_INDEX = math.sqrt(2.0)
"""Index above which light along the coating is reflected totally by walls at right angles."""
FACING = (("left", "right"), ("base", "tip"))
"""Walls that face each other; the first pair does so on bent pads as well."""
FLAT = math.radians(5.0)
"""Bend below which ends of a pad send light back like those of a flat one, about."""


def serves_all_lamps(scene: Scene, bend: float) -> bool:
    """Return whether one sample serves all lamps (``render.cells.clear.clear_cells``).

    That is on flat clear pads of smooth or painted faces with lamps in the air; ``bend`` in rad.
    Others are rendered lamp by lamp (``render.cells.cell_sampler``).
    """
    layer = scene.diffuser
    clear = layer is None or layer.sigma_s + layer.sigma_a == 0.0
    smooth = all(finish.smooth or finish.paint is not None for finish in scene.finishes)
    boundary = scene.pad.index != 1.0
    pad = clear and smooth and boundary and scene.coating.lobe is None
    return bend == 0.0 and pad and not _cast_in(scene)


def check_rendered(scene: Scene, bends: Iterable[float]) -> None:
    """Refuse a sensor that no estimator renders with error bars that hold at all ``bends``.

    These are in rad, or numbers of its states. On a flat pad walls that face each other show a
    lamp in the silicone over and over where they are metal, or where total reflection traps its
    light. Paths that meet far images are too rare to be known.

    Raises:
        RenderError: names the walls, and what could be rendered.
    """
    if not _cast_in(scene):
        return
    flat = any(in_state(scene, bend)[1] < FLAT for bend in bends)
    walls = _trapping_walls(scene) if flat else _metal_walls(scene, FACING[:1])
    if walls:
        raise RenderError(
            f"the reference does not render lamps cast into silicone between {walls}: light goes "
            "to and fro between them, beyond what samples can know; allowed: a roughness or black "
            "paint on one of them, or lamps outside; explore works without renders",
            field="faces",
        )


def _trapping_walls(scene: Scene) -> str:
    """Return in words which faces of a flat pad show a lamp over and over, "" for none."""
    metal = _metal_walls(scene, FACING)
    if metal:
        return metal
    mirror = dict(zip(FACES, mirror_faces(scene), strict=True))
    smooth = [" and ".join(pair) for pair in FACING if all(mirror[face] for face in pair)]
    solids = {lamp.solid for lamp in scene.placed_lamps()} - {None}
    # Along the faces light keeps what its own medium gave it.
    index = scene.pad.index
    if scene.window is not None and "window" in solids:
        index = scene.window.index if solids == {"window"} else max(index, scene.window.index)
    if smooth and index > TRAPPED_INDEX:
        return f"{smooth[0]}, smooth and of index {index:g} (up to 1.41 they let it go)"
    layer = scene.diffuser
    strip = layer is not None and layer.sigma_s == 0.0 and scene.box.layered.any()
    if strip and scene.pad.roughness == 0.0 and mirror["lower"]:
        return "the smooth upper and lower faces of a clear layer (diffuser.sigma_s = 0)"
    return ""


def _metal_walls(scene: Scene, pairs: tuple[tuple[str, str], ...]) -> str:
    """Return in words the first of ``pairs`` of walls that are mirrors of metal, "" for none."""
    for pair in pairs:
        if all(scene.finish(face).metal is not None for face in pair):
            return f"the mirrors {pair[0]} and {pair[1]}"
    return ""


def _cast_in(scene: Scene) -> bool:
    return any(lamp.solid for lamp in scene.placed_lamps())
