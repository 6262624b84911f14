"""The fit through the surrogate, brought to the reference: render, correct, fit again, confirm.

First come renders of materials that fill the range, which every rig of the same design shares; then
of what was found so far. All of them correct the model (``hw.calibration.material_correction``),
and the fit is repeated, until it moves by less than its own error. The last render, with random
numbers that no fit has seen, only judges: it is compared with the photographs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hw.calibration.line_model import LineModel
from hw.calibration.material import HIGH, LOW, Material
from hw.calibration.material_correction import material_correction
from hw.calibration.measurement import Measurement
from hw.calibration.model_error import field_modes, joined
from hw.calibration.pad_light import PadLight, render_pad_light
from hw.calibration.reference_lines import ReferenceLines, reference_lines
from hw.calibration.reference_renders import MaterialRender, reference_renders
from hw.calibration.rig_fit import Calibration, fit_rig
from render.arrays import Array
from render.progress import OnProgress, in_stage
from tactilux import Scene

UNCORRECTED_ERROR = 0.03
"""Relative error of the shape of light that even the best correction leaves: so much do corrected
models differ from emulated photographs of the same material."""
MAX_RENDERS = 3
"""Renders of what was found, at most."""
CONVERGED = 1.0
"""Standard errors within which a repeated fit counts as unmoved."""
FITS = 3
"""Fits to one correction: how sure it is depends on the material that is found."""
ERROR_FLOOR = 0.02
"""Relative difference below which the weights of noisy cells do not matter."""


@dataclass(frozen=True)
class Confirmation:
    """Photographs against renders along the reference lines, relative.

    Arguments:
        rms: of photographs over renders less 1, by cells of the render.
        noise: what the errors of renders and photographs explain of it.
        before: rms of photographs over the model for the scene as it was.
        samples: light paths per fiber and cell.
        seconds: of all renders.
        renders: of how many materials, the last of which is the one that is confirmed.
    """

    rms: float
    noise: float
    before: float
    samples: int
    seconds: float
    renders: int


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
    progress: OnProgress | None = None,
    render: Callable[..., PadLight] = render_pad_light,
) -> tuple[Calibration, Confirmation]:
    """Return the calibration as renders correct it, and what confirms it.

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
    found = _refit(scene, model, measurements, renders, found)
    moved = np.inf
    for number in range(1, MAX_RENDERS + 1):
        light = render(
            found.material.put_into(scene), phi, bends, lit, samples=samples, seed=10 + number,
            around=lines.on_pad,
            progress=in_stage(progress, f"what was found, {number}"),
        )  # fmt: skip
        if moved <= CONVERGED or number == MAX_RENDERS:
            break
        renders = [*renders, MaterialRender(found.material.array(), light)]
        again = _refit(scene, model, measurements, renders, found)
        step = (again.material.array() - found.material.array()) / again.errors.material
        moved, found = float(np.abs(step).max()), again
    rms, noise = shape_difference(light, found, measurements, lines)
    known = np.clip(Material.of(scene).array(), LOW, HIGH)
    before, _ = shape_difference(light, found, measurements, lines, model.log_light(known))
    seconds = time.monotonic() - began
    return found, Confirmation(rms, noise, before, samples, seconds, materials + number)


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
    uncorrected = field_modes(np.full(len(read), UNCORRECTED_ERROR), scene.fibers.count)
    # The table is corrected as it was drawn, without the surrogate.
    no_surrogate = np.zeros_like(model.log_correction)
    for _ in range(FITS):
        modes = joined(correction.modes(found.material.array()), uncorrected)
        corrected = LineModel(correction.table, no_surrogate, modes)
        found = fit_rig(scene, corrected, measurements, found.material)
    return found


def shape_difference(
    light: PadLight,
    found: Calibration,
    measurements: list[Measurement],
    lines: ReferenceLines,
    log_light: Array | None = None,
) -> tuple[float, float]:
    """Return rms and expected rms of photographs over renders, less 1, by cells of the render.

    Compared is the shape of the light along the reference lines; the brightness of each photograph
    is matched first, because its fiber's power is fitted to nothing else.

    Arguments:
        light: as rendered.
        found: the camera's gains, tilt and vignetting.
        measurements: the photographs.
        lines: of the scene.
        log_light: ``(bend, fiber, point)`` of a model that is compared instead of ``light``.
    """
    differences, errors, weights = [], [], []
    for one in measurements:
        radiance, error = light.at(one.bend, one.fiber, lines.position[one.fiber])
        shade = 1 - found.vignetting * one.radius2
        seen = one.counts + np.einsum("tpc,t->pc", one.tilt_slope, found.tilt)
        lit = one.channels
        with np.errstate(invalid="ignore", divide="ignore"):
            modeled = np.log(radiance) if log_light is None else log_light[one.bend, one.fiber]
            measured = np.log((seen[:, lit] / found.gain[lit]).mean(axis=1) / shade)
            relative = np.hypot(error / radiance, one.noise / seen[:, lit].mean(axis=1))
        usable = one.used & np.isfinite(measured + modeled + relative)
        if not usable.any():
            continue
        cell = light.cell_of(lines.position[one.fiber][usable])
        _, index, size = np.unique(cell, return_inverse=True, return_counts=True)
        difference = np.bincount(index, (measured - modeled)[usable]) / size
        noise = np.bincount(index, relative[usable]) / size
        weight = size / (noise**2 + ERROR_FLOOR**2)
        differences.append(difference - np.average(difference, weights=weight))
        errors.append(noise)
        weights.append(weight)
    weight = np.concatenate(weights)
    return (
        float(np.sqrt(np.average(np.concatenate(differences) ** 2, weights=weight))),
        float(np.sqrt(np.average(np.concatenate(errors) ** 2, weights=weight))),
    )
