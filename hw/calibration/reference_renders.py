"""Renders of materials that fill the range: what every rig of one design is calibrated with.

They depend on the scene's geometry, the fibers' directions and the bends, not on photographs. So
they are kept in the user's cache, one file each, and interrupted work goes on where it stood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np

from hw.calibration.material import Material
from hw.calibration.material_correction import MaterialRender
from hw.calibration.material_table import design_key, sobol_materials
from hw.calibration.pad_light import PadLight, render_pad_light
from hw.calibration.reference_lines import reference_lines
from render.arrays import Array
from render.files import read_or_drop, write_npz
from render.progress import Progress
from render.scene.schema import Scene

VERSION = 1
FIRST_SEED = 5000

NamedProgress = Callable[[str, Progress], None]
"""Called with what is rendered and how far it is."""


def reference_renders(
    scene: Scene,
    phi: Array,
    bends: Array,
    lit: Sequence[Sequence[int]],
    *,
    materials: int,
    samples: int,
    folder: Path,
    progress: NamedProgress | None = None,
    render: Callable[..., PadLight] = render_pad_light,
) -> list[MaterialRender]:
    """Return renders of ``materials`` that fill the range (Sobol), kept or made now.

    Arguments:
        scene: whose own material does not matter.
        phi: ``(fiber,)`` rad.
        bends: ``(bend,)`` rad.
        lit: numbers of the fibers that are rendered, for each bend.
        materials: how many.
        samples: light paths per fiber and cell of the pad, for each.
        folder: where they are kept.
        progress: called every few seconds.
        render: what renders.
    """
    key = design_key(VERSION, scene, phi, bends, [[int(f) for f in own] for own in lit], samples)
    where = reference_lines(scene).on_pad
    chosen = sobol_materials(materials)
    paths = [folder / f"renders-{key}" / f"{number:03d}.npz" for number in range(materials)]
    found = []
    for number, (material, path) in enumerate(zip(chosen, paths, strict=True)):
        kept = read_or_drop(path, *(field.name for field in fields(PadLight)))
        if kept is None:
            later = sum(not one.exists() for one in paths[number + 1 :])
            light = render(
                Material.from_array(material).put_into(scene), phi, bends, lit, samples=samples,
                seed=FIRST_SEED + number, around=where,
                progress=_of_all(progress, number + 1, materials, later),
            )  # fmt: skip
            write_npz(path, {name: np.asarray(value) for name, value in vars(light).items()})
        else:
            light = PadLight(
                float(kept["cell"]), int(kept["blocks"]), kept["radiance"], kept["error"]
            )
        found.append(MaterialRender(material, light))
    return found


def named(progress: NamedProgress | None, name: str) -> Callable[[Progress], None] | None:
    """Return ``progress`` for what has this name."""
    return None if progress is None else partial(progress, name)


def _of_all(
    progress: NamedProgress | None, number: int, materials: int, later: int
) -> Callable[[Progress], None] | None:
    """Return what tells the progress of one render as that of all, ``later`` ones included."""
    if progress is None:
        return None

    def said(at: Progress) -> None:
        eta = at.eta_seconds + later * (at.seconds + at.eta_seconds)
        done, total = at.done + (number - 1) * at.total, materials * at.total
        progress(f"material {number} of {materials}", Progress(done, total, at.seconds, eta))

    return said
