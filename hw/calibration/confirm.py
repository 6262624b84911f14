"""Confirming a calibration: renders of the calibrated scene against the photographs.

Compared is the shape of the light along the reference lines; the brightness of each photograph is
matched first, because its fiber's power is fitted to nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hw.calibration.fit import Calibration
from hw.calibration.measurement import Measurement
from hw.calibration.pad_light import PadLight
from hw.calibration.reference_lines import ReferenceLines
from render.arrays import Array

MIN_DIFFERENCE = 0.02
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


def against_light(
    light: PadLight, found: Calibration, measurements: list[Measurement], lines: ReferenceLines
) -> tuple[float, float]:
    """Return rms and expected rms of photographs over renders."""

    def expected(one: Measurement) -> tuple[Array, Array]:
        radiance, error = light.at(one.bend, one.fiber, lines.position[one.fiber])
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.log(radiance), error / radiance

    return _compared(expected, light, found, measurements, lines)


def against_model(
    log_light: Array,
    light: PadLight,
    found: Calibration,
    measurements: list[Measurement],
    lines: ReferenceLines,
) -> float:
    """Return the rms of photographs over a model, ``(bend, fiber, point)``, by the same cells."""

    def expected(one: Measurement) -> tuple[Array, Array]:
        radiance, error = light.at(one.bend, one.fiber, lines.position[one.fiber])
        with np.errstate(invalid="ignore", divide="ignore"):
            return log_light[one.bend, one.fiber], error / radiance

    return _compared(expected, light, found, measurements, lines)[0]


def _compared(
    expected: Callable[[Measurement], tuple[Array, Array]],
    light: PadLight,
    found: Calibration,
    measurements: list[Measurement],
    lines: ReferenceLines,
) -> tuple[float, float]:
    differences, errors, weights = [], [], []
    for one in measurements:
        log_light, relative = expected(one)
        shade = 1 - found.vignetting * one.radius2
        seen = one.counts + np.einsum("tpc,t->pc", one.tilt_slope, found.tilt)
        own = one.channels
        with np.errstate(invalid="ignore", divide="ignore"):
            measured = np.log((seen[:, own] / found.gain[own]).mean(axis=1) / shade)
            error = np.hypot(relative, one.noise / seen[:, own].mean(axis=1))
        usable = one.used & np.isfinite(measured + log_light + error)
        if not usable.any():
            continue
        cell = light.cell_of(lines.position[one.fiber][usable])
        _, index, size = np.unique(cell, return_inverse=True, return_counts=True)
        difference = np.bincount(index, (measured - log_light)[usable]) / size
        noise = np.bincount(index, error[usable]) / size
        weight = size / (noise**2 + MIN_DIFFERENCE**2)
        differences.append(difference - np.average(difference, weights=weight))
        errors.append(noise)
        weights.append(weight)
    weight = np.concatenate(weights)
    return (
        float(np.sqrt(np.average(np.concatenate(differences) ** 2, weights=weight))),
        float(np.sqrt(np.average(np.concatenate(errors) ** 2, weights=weight))),
    )
