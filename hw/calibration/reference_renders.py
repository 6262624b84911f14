"""Renders of materials that fill the range: what every rig of one design is calibrated with.

They depend on the scene's geometry, the fibers' directions and the bends, not on photographs. So
they are kept in the user's cache, one file each, and interrupted work goes on where it stood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from hw.calibration.log_ratio import LogRatios, log_ratios
from hw.calibration.material import Material, design_key, sobol_materials
from hw.calibration.pad_light import PadLight, render_pad_light
from hw.calibration.reference_lines import frame_positions, reference_lines
from render.arrays import Array
from render.files import read_or_drop, write_npz
from render.progress import OnProgress, Progress
from tactilux import Scene

VERSION = 1
FIRST_SEED = 5000


@dataclass(frozen=True, eq=False)
class MaterialRender:
    """One material, rendered.

    Arguments:
        material: ``(4,)``.
        light: of the fibers that matter at each bend.
    """

    material: Array
    light: PadLight

    def log_ratios(self, bend: int, fiber: int, position: Array, log_light: Array) -> LogRatios:
        """Return what it says about one fiber at its lines.

        Arguments:
            bend: its index.
            fiber: its number.
            position: ``(point, 2)`` mm on the flat pad.
            log_light: ``(point,)`` of the table, NaN where nothing is wanted.
        """
        radiance, error = self.light.at(bend, fiber, position)
        parts = self.light.part_of(position)
        return log_ratios(frame_positions(), parts, radiance, error, log_light)


def reference_renders(
    scene: Scene,
    phi: Array,
    bends: Array,
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
    around = reference_lines(scene).on_pad
    paths = [folder / f"renders-{key}" / f"{number:03d}.npz" for number in range(materials)]
    renders = []
    for number, material in enumerate(sobol_materials(materials)):
        kept = read_or_drop(paths[number], *(field.name for field in fields(PadLight)))
        if kept is None:
            missing = sum(not path.exists() for path in paths[number + 1 :])
            light = render(
                Material.from_array(material).put_into(scene), phi, bends, lit, samples=samples,
                seed=FIRST_SEED + number, around=around,
                progress=_of_all(progress, number + 1, materials, missing) if progress else None,
            )  # fmt: skip
            write_npz(paths[number], {name: np.asarray(v) for name, v in vars(light).items()})
        else:
            light = PadLight(
                float(kept["cell"]), int(kept["blocks"]), kept["radiance"], kept["error"]
            )
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
