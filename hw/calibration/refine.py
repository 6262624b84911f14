"""The fit through the surrogate, brought to the reference: render, correct, fit again, confirm.

First come renders of materials that fill the range, which every rig of the same design shares; then
of what was found so far. All of them correct the model (``hw.calibration.material_correction``),
and the fit is repeated, until it moves by less than its own error. The last render, with random
numbers that no fit has seen, only judges.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from hw.calibration.confirm import Confirmation, against_light, against_model
from hw.calibration.fit import Calibration
from hw.calibration.material import HIGH, LOW, Material
from hw.calibration.material_correction import MaterialRender, material_correction
from hw.calibration.measurement import Measurement
from hw.calibration.model_error import field_modes, joined
from hw.calibration.pad_light import PadLight, render_pad_light
from hw.calibration.reference_lines import reference_lines
from hw.calibration.reference_renders import named, reference_renders
from hw.calibration.rig_fit import LineModel, fit_rig
from render.arrays import Array
from render.progress import Progress
from render.scene.schema import Scene

UNCORRECTED_ERROR = 0.03
"""Relative error of the shape of light that even the best correction leaves: so much do corrected
models differ from emulated photographs of the same material."""
ROUNDS = 3
"""Renders of what was found, at most."""
CONVERGED_SIGMAS = 1.0
"""Standard errors within which a repeated fit counts as unmoved."""
FITS = 3
"""Fits to one correction: how sure it is depends on the material that is found."""


@dataclass(frozen=True, eq=False)
class Refined:
    """What came out: the fit and its confirmation."""

    found: Calibration
    confirmation: Confirmation


def refine(
    scene: Scene,
    model: LineModel,
    found: Calibration,
    measurements: list[Measurement],
    phi: Array,
    bends: Array,
    *,
    materials: int,
    samples: int,
    folder: Path,
    progress: Callable[[str, Progress], None] | None = None,
    render: Callable[..., PadLight] = render_pad_light,
) -> Refined:
    """Return the calibration as renders correct and confirm it.

    Arguments:
        scene: before calibration.
        model: that ``found`` was fitted with.
        found: the fit through the surrogate.
        measurements: the photographs.
        phi: ``(fiber,)`` rad.
        bends: ``(bend,)`` rad.
        materials: how many are rendered for all rigs of this design.
        samples: light paths per photographed fiber and cell of the pad, for each render.
        folder: where renders for all rigs are kept.
        progress: called every few seconds with what is rendered and how far it is.
        render: what renders.
    """
    lit = [[one.fiber for one in measurements if one.bend == b] for b in range(len(bends))]
    lines, began = reference_lines(scene), time.monotonic()
    renders = reference_renders(
        scene, phi, bends, lit,
        materials=materials, samples=samples, folder=folder, progress=progress, render=render,
    )  # fmt: skip
    refit = partial(_refit, scene, model, measurements)
    found = refit(renders, found)
    moved = np.inf
    for number in range(1, ROUNDS + 1):
        light = render(
            found.material.put_into(scene), phi, bends, lit, samples=samples, seed=10 + number,
            around=lines.on_pad, progress=named(progress, f"what was found, {number}"),
        )  # fmt: skip
        if moved <= CONVERGED_SIGMAS or number == ROUNDS:
            break
        renders = [*renders, MaterialRender(found.material.array(), light)]
        again = refit(renders, found)
        step = (again.material.array() - found.material.array()) / again.intervals.material
        moved, found = float(np.abs(step).max()), again
    rms, noise = against_light(light, found, measurements, lines)
    before = against_model(model.log_light(_known(scene)), light, found, measurements, lines)
    return Refined(
        found,
        Confirmation(rms, noise, before, samples, time.monotonic() - began, materials + number),
    )


def _refit(
    scene: Scene,
    model: LineModel,
    measurements: list[Measurement],
    renders: list[MaterialRender],
    found: Calibration,
) -> Calibration:
    """Return the fit with the model as ``renders`` correct it; it starts at ``found``."""
    read = np.zeros(model.table.coefficients.shape[1:], dtype=np.bool_)
    for one in measurements:
        read[one.bend, one.fiber] = one.used
    correction = material_correction(model.table, renders, read, reference_lines(scene))
    left = field_modes(np.full(len(read), UNCORRECTED_ERROR), scene.fibers.count)
    # The table is corrected as it was drawn, without the surrogate.
    none = np.zeros_like(model.log_correction)
    for _ in range(FITS):
        modes = joined(correction.modes(found.material.array()), left)
        corrected = replace(model, table=correction.table, log_correction=none, modes=modes)
        found = fit_rig(scene, corrected, measurements, found.material)
    return found


def _known(scene: Scene) -> Material:
    """Return the scene's own material, brought into the range that the table knows."""
    return Material.from_array(np.clip(Material.of(scene).array(), LOW, HIGH))
