"""The fit through the surrogate, brought to the reference: render, correct, fit again, confirm.

First come renders of materials that fill the range, which every rig of the same design shares; then
of what was found so far. All of them correct the model (``hw.calibration.material_correction``),
and the fit is repeated, until it moves by less than its own error. The last render, with random
numbers that no fit has seen, only judges: it is compared with the photographs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hw.calibration.line_model import LineModel, error_modes, with_channels
from hw.calibration.material_correction import MaterialCorrection
from hw.calibration.measurement import Measurement
from hw.calibration.pad_light import MaterialRender, PadLight, reference_renders, render_pad_light
from hw.calibration.reference_lines import ReferenceLines, Setup
from hw.calibration.rig_fit import Calibration, fit_rig
from render.arrays import Array
from render.progress import OnProgress, in_stage

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
    setup: Setup,
    model: LineModel,
    found: Calibration,
    measurements: list[Measurement],
    *,
    materials: int,
    samples: int,
    folder: Path,
    progress: OnProgress | None = None,
    render: Callable[..., PadLight] = render_pad_light,
) -> tuple[Calibration, Confirmation]:
    """Return the calibration as renders correct it, and what confirms it.

    ``setup`` is that before calibration and ``found`` the fit through the surrogate, with
    ``model``. ``materials`` are rendered for all rigs of this design and kept in ``folder``; every
    ``render`` takes ``samples`` light paths per photographed fiber and cell of the pad.
    """
    lit = [[one.fiber for one in measurements if one.bend == b] for b in range(len(setup.bends))]
    began = time.monotonic()
    renders = reference_renders(
        setup.one_albedo, lit,
        materials=materials, samples=samples, folder=folder, progress=progress, render=render,
    )  # fmt: skip
    found = _refit(setup, model, measurements, renders, found)
    moved = np.inf
    for number in range(1, MAX_RENDERS + 1):
        material = found.material
        # One light for all channels, or each one's own.
        seen = np.atleast_2d(setup.space.seen(material))
        lights = [
            render(
                setup.one_albedo.of(one), lit, samples=samples, seed=10 + number,
                around=setup.lines.on_pad, progress=in_stage(progress, f"what was found, {number}"),
            )
            for one in seen
        ]  # fmt: skip
        if moved <= CONVERGED or number == MAX_RENDERS:
            break
        renders = [*renders, *map(MaterialRender, seen, lights)]
        found = _refit(setup, model, measurements, renders, found)
        moved = float(np.abs((found.material - material) / found.errors.material).max())
    rms, noise = shape_difference(lights, found, measurements, setup.lines)
    space = setup.space
    known = np.clip(space.of(setup.scene), space.low, space.high)
    log_light = model.log_light(known)
    before, _ = shape_difference(lights, found, measurements, setup.lines, log_light)
    seconds = time.monotonic() - began
    rendered = materials + number * len(lights)
    return found, Confirmation(rms, noise, before, samples, seconds, rendered)


def _refit(
    setup: Setup,
    model: LineModel,
    measurements: list[Measurement],
    renders: list[MaterialRender],
    found: Calibration,
) -> Calibration:
    """Return the fit with the model as ``renders`` correct it; it starts at ``found``."""
    read = np.zeros(model.table.coefficients.shape[1:], dtype=np.bool_)
    for one in measurements:
        read[one.bend, one.fiber] = one.used
    correction = MaterialCorrection(model.table, renders, read, setup.lines)
    uncorrected = error_modes(
        np.full(len(read), UNCORRECTED_ERROR), len(setup.phi), len(setup.space.of_channel)
    )
    # The table is corrected as it was drawn, without the surrogate.
    no_surrogate = np.zeros_like(model.log_correction)
    for _ in range(FITS):
        open_modes = correction.modes(setup.space.seen(found.material))
        modes = tuple(map(np.concatenate, zip(open_modes, uncorrected, strict=True)))
        corrected = LineModel(setup.space, correction.table, no_surrogate, modes)
        found = fit_rig(setup.scene, corrected, measurements, found.material)
    return found


def shape_difference(
    lights: Sequence[PadLight],
    found: Calibration,
    measurements: list[Measurement],
    lines: ReferenceLines,
    log_light: Array | None = None,
) -> tuple[float, float]:
    """Return rms and expected rms of photographs over renders, less 1, by cells of the render.

    Compared is the shape of the light along the reference lines; the brightness of each photograph
    is matched first, because its fiber's power is fitted to nothing else.

    There is one of ``lights`` for all channels, which are averaged, or one for each.

    ``log_light`` ``(bend, fiber, point[, channel])`` of a model is compared instead of ``lights``
    where given.
    """
    cells = []
    compared = [
        (one, lit, number)
        for one in measurements
        for number, lit in (
            [(0, one.channels)] if len(lights) == 1 else [(c, [c]) for c in one.channels]
        )
    ]
    for one, lit, number in compared:
        position, light = lines.position[one.fiber], lights[number]
        radiance, error = light.at(one.bend, one.fiber, position)
        shade = 1 - found.vignetting * one.radius2
        seen = one.untilted(found.tilt)[:, lit]
        with np.errstate(invalid="ignore", divide="ignore"):
            modeled = np.log(radiance)
            if log_light is not None:
                modeled = with_channels(log_light[one.bend, one.fiber], 1)[:, number]
            difference = np.log((seen / found.gain[lit]).mean(axis=1) / shade) - modeled
            relative = np.hypot(error / radiance, one.noise / seen.mean(axis=1))
        usable = one.used & np.isfinite(difference + relative)
        if usable.any():
            cell = light.square_of(position[usable], light.blocks)
            _, index, size = np.unique(cell, return_inverse=True, return_counts=True)
            difference, noise = (
                np.bincount(index, values[usable]) / size for values in (difference, relative)
            )
            weight = size / (noise**2 + ERROR_FLOOR**2)
            difference -= np.average(difference, weights=weight)
            cells.append(np.stack([difference, noise, weight]))
    difference, noise, weight = np.concatenate(cells, axis=1)
    rms, expected = (np.average(values**2, weights=weight) for values in (difference, noise))
    return float(np.sqrt(rms)), float(np.sqrt(expected))
