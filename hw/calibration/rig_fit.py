"""From photographs to a calibration: the steps in their order, for real and emulated rigs alike.

Powers are relative: their mean is 1, the gains hold the rest. Only the reduced scattering is
fitted: g and sigma_s alone leave the same photographs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from hw.calibration.line_model import LineModel
from hw.calibration.material import HIGH, LOW, NAMES, PER_UNIT, UNITS, Material
from hw.calibration.measurement import LineReader, Measurement
from hw.calibration.reference_lines import Setup
from hw.calibration.residuals import (
    MATERIAL,
    TILT,
    VIGNETTING,
    CalibrationResiduals,
    StandardErrors,
    standard_errors,
)
from hw.camera.linearity import Linearity, linearity
from hw.camera.photo_set import PhotoSet
from hw.errors import CalibrationError
from optimize.scoring import normal_factor
from render.arrays import Array
from tactilux import Scene

ROUNDS = 2
"""Fits, each weighed by what the one before predicts."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What the fit found.

    Arguments:
        material: best values.
        power: ``(fiber,)`` relative, mean 1; NaN for fibers that were not photographed.
        gain: ``(3,)`` counts per unit radiance and power.
        tilt: ``(3,)`` rad; vignetting: part of light lost at the corners.
        errors: of all these.
        predicted: list of ``(point, 3)`` counts, one for every measurement.
        chi: rms of residuals in units of their expected errors.
    """

    material: Material
    power: Array
    gain: Array
    tilt: Array
    vignetting: float
    errors: StandardErrors
    predicted: list[Array]
    chi: float

    @property
    def intervals(self) -> list[tuple[float, float]]:
        """95 % intervals of the material's values, in the order of `NAMES`; none below 0."""
        factor = normal_factor()
        return [
            (max(float(value - factor * se), 0.0), float(value + factor * se))
            for value, se in zip(self.material.array(), self.errors.material, strict=True)
        ]

    def require_known(self) -> None:
        """Refuse a fit that ended where the model is not known.

        Raises:
            CalibrationError: the material lies at the end of its range.
        """
        material, span = self.material.array(), HIGH - LOW
        at_end = (material < LOW + 1e-3 * span) | (material > HIGH - 1e-3 * span)
        # Absorption and roughness may well be as small as can be.
        at_end[1] &= material[1] > HIGH[1] / 2
        at_end[3] &= material[3] > HIGH[3] / 2
        if at_end.any():
            index = int(np.argmax(at_end))
            low, high = PER_UNIT[index] * LOW[index], PER_UNIT[index] * HIGH[index]
            raise CalibrationError(
                f"the photographs ask for a {NAMES[index].replace('_', ' ')} beyond the range that "
                f"is known, allowed: {low:.3g} to {high:.3g} {UNITS[index]}; see that the scene's "
                "lengths are those of the rig",
                field=NAMES[index],
            )


def require_linearity(sets: list[PhotoSet], noise: float) -> Linearity:
    """Return the test of the first sweep that also shows all fibers together, and require it.

    Raises:
        CalibrationError: light does not add up, or no sweep shows all fibers together.
    """
    for photos in sets:
        if photos.together is not None:
            tested = linearity(np.stack(list(photos.alone.values())), photos.together, noise)
            tested.require()
            return tested
    raise CalibrationError(
        "no sweep shows all fibers together, so the camera cannot be tested for linearity: capture "
        "one with `tactilux hw capture` and give it with --linearity",
        field="linearity",
    )


def measure(setup: Setup, sets: list[PhotoSet], noise: float) -> list[Measurement]:
    """Return the reference lines of all photographs; ``sets`` are in the order of the bends."""
    reader = LineReader(setup, noise)
    return [
        reader.read(photo, fiber, bend)
        for bend, photos in enumerate(sets)
        for fiber, photo in sorted(photos.alone.items())
    ]


def fit_rig(
    scene: Scene,
    model: LineModel,
    measurements: list[Measurement],
    start: Material | None = None,
) -> Calibration:
    """Return the best material, powers and gains, with their errors.

    The roughness of ``scene`` is known, and its own material is where the fit starts unless
    ``start`` is given. Errors of ``model`` are fitted with the rest; there is a photograph at each
    of its bends.

    Raises:
        CalibrationError: too few photographs or too dark ones, or the fit does not converge.
    """
    from scipy.optimize import least_squares

    dark = [one.fiber for one in measurements if not one.channels or one.used.sum() < 10]
    if dark:
        raise CalibrationError(
            f"fiber {dark[0]} lights too few points of its reference lines: mend or leave out that "
            "fiber, or raise the exposure",
            field="fiber",
        )
    problem = CalibrationResiduals(model, measurements, scene.pad.roughness)
    x = problem.start(start or Material.of(scene))
    low, high = problem.bounds()
    for _ in range(ROUNDS):
        fit = least_squares(
            problem.residuals,
            np.clip(x, low + 1e-6, high - 1e-6),
            jac=problem.jacobian,
            bounds=(low, high),
            x_scale=problem.scale(),
            loss=partial(_robust, problem.rows),
            ftol=1e-8,
            xtol=1e-7,
            max_nfev=200,
        )
        if not fit.success or not np.isfinite(fit.x).all():
            raise CalibrationError(
                "the fit of the material did not converge: capture again with more light and see "
                "that the scene's lengths are those of the rig",
                field="calibration",
            )
        x = fit.x
        problem.weigh(x)
    powers, gains = np.full(scene.lamp_count, np.nan), np.full(3, np.nan)
    powers[problem.fibers], gains[problem.channels] = problem.unpack(x)
    residuals = problem.residuals(x)[: problem.rows]
    return Calibration(
        material=Material.from_array(x[MATERIAL]),
        power=powers,
        gain=gains,
        tilt=x[TILT],
        vignetting=float(x[VIGNETTING]),
        errors=standard_errors(problem, x),
        predicted=problem.predictions(x),
        chi=float(np.sqrt(np.mean(residuals[residuals != 0] ** 2))),
    )


def _robust(rows: int, squares: Array) -> Array:
    """Return the loss of squared residuals and its two derivatives, ``(3, residual)``.

    Soft l1 for the ``rows`` of the photographs, so that dust counts for little; the amplitudes of
    the model's errors after them are what they are.
    """
    root = np.sqrt(1 + squares)
    loss = np.stack([2 * (root - 1), 1 / root, -0.5 / root**3])
    loss[0, rows:], loss[1, rows:], loss[2, rows:] = squares[rows:], 1.0, 0.0
    return loss
