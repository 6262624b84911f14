"""Renders of materials that fill the range: what every rig of one design is calibrated with.

They depend on the scene's geometry, the fibers' directions and the bends, not on photographs. So
they are kept in the user's cache, one file each, and interrupted work goes on where it stood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hw.calibration.material import sobol_materials
from hw.calibration.pad_light import PadLight, render_pad_light
from hw.calibration.reference_lines import Setup
from render.arrays import Array
from render.files import read_or_drop, write_npz
from render.progress import OnProgress, Progress

VERSION = 1
FIRST_SEED = 5000


class MaterialRender(NamedTuple):
    """One material ``(4,)``, and its light at each bend under the fibers that matter there."""

    material: Array
    light: PadLight


def reference_renders(
    setup: Setup,
    lit: Sequence[Sequence[int]],
    *,
    materials: int,
    samples: int,
    folder: Path,
    progress: OnProgress | None = None,
    render: Callable[..., PadLight] = render_pad_light,
) -> list[MaterialRender]:
    """Return renders of ``materials`` that fill the range (Sobol), kept or made now.

    Arguments:
        setup: whose own material does not matter.
        lit: numbers of the fibers that are rendered, for each bend.
        materials: how many.
        samples: light paths per fiber and cell of the pad, for each.
        folder: where they are kept.
        progress: called every few seconds.
        render: what renders.
    """
    key = setup.key(VERSION, [[int(fiber) for fiber in own] for own in lit], samples)
    paths = [folder / f"renders-{key}" / f"{number:03d}.npz" for number in range(materials)]
    renders = []
    for number, material in enumerate(sobol_materials(materials)):
        kept = read_or_drop(paths[number], *(field.name for field in fields(PadLight)))
        if kept is None:
            missing = sum(not path.exists() for path in paths[number + 1 :])
            light = render(
                setup.of(material), lit, samples=samples, seed=FIRST_SEED + number,
                around=setup.lines.on_pad,
                progress=_of_all(progress, number + 1, materials, missing) if progress else None,
            )  # fmt: skip
            kept = {name: np.asarray(value) for name, value in vars(light).items()}
            write_npz(paths[number], kept)
        light = PadLight(float(kept["cell"]), int(kept["blocks"]), kept["radiance"], kept["error"])
        renders.append(MaterialRender(material, light))
    return renders


def _of_all(progress: OnProgress, number: int, materials: int, missing: int) -> OnProgress:
    """Return what tells the progress of one render as that of all, ``missing`` ones included."""

    def said(at: Progress) -> None:
        remaining = at.eta_seconds or 0.0
        eta = remaining + missing * (at.seconds + remaining)
        done, total = at.done + (number - 1) * at.total, materials * at.total
        stage = f"material {number} of {materials}"
        progress(Progress(done, total, at.seconds, eta, stage))

    return said
