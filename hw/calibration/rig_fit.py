"""From photographs to a calibration: the steps in their order, for real and emulated rigs alike.

Powers are relative: their mean is 1, the gains hold the rest. Only the reduced scattering is
fitted: g and sigma_s alone leave the same photographs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hw.calibration.line_model import LineModel
from hw.calibration.material import MaterialSpace
from hw.calibration.measurement import LineReader, Measurement
from hw.calibration.reference_lines import Setup
from hw.calibration.residuals import CalibrationResiduals, StandardErrors, standard_errors
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
        space: of the material.
        material: ``(quantity,)`` of `space`, the best.
        power: ``(fiber,)`` relative, mean 1; NaN for fibers that were not photographed.
        gain: ``(channel,)`` counts per unit radiance and power.
        tilt: ``(3,)`` rad; vignetting: part of light lost at the corners.
        errors: of all these.
        predicted: list of ``(point, channel)`` counts, one for every measurement.
        chi: rms of residuals in units of their expected errors.
    """

    space: MaterialSpace
    material: Array
    power: Array
    gain: Array
    tilt: Array
    vignetting: float
    errors: StandardErrors
    predicted: list[Array]
    chi: float

    @property
    def intervals(self) -> list[tuple[float, float]]:
        """95 % intervals of the material's values in their units, none that cannot be."""
        half = normal_factor() * self.errors.material
        ends = np.stack([np.maximum(self.material - half, 0.0), self.material + half])
        most = [one.most * one.per_unit for one in self.space.quantities]
        return [(low, high) for low, high in np.minimum(self.space.told(ends), most).T.tolist()]

    def require_known(self) -> None:
        """Refuse a fit that ended where the model is not known.

        Raises:
            CalibrationError: the material lies at the end of its range.
        """
        values = self.space.values(self.material)
        for one, value in zip(self.space.quantities, values, strict=True):
            margin = 1e-3 * (one.high - one.low)
            too_small = value < one.low + margin and not one.may_vanish
            if too_small or value > one.high - margin:
                low, high = one.per_unit * one.low, one.per_unit * one.high
                raise CalibrationError(
                    f"the photographs ask for a {one.name.replace('_', ' ')} beyond the range that "
                    f"is known, allowed: {f'{low:.3g} to {high:.3g} {one.unit}'.rstrip()}; see "
                    "that the scene's lengths are those of the rig",
                    field=one.name,
                )


def measure(setup: Setup, sets: list[PhotoSet], noise: float) -> list[Measurement]:
    """Return the reference lines of all photographs; ``sets`` are in the order of the bends.

    ``noise`` is that of one pixel in counts; what files lost by compression adds to it.
    """
    reader, measured = LineReader(setup, noise), []
    for bend, photos in enumerate(sets):
        for fiber, photo in sorted(photos.alone.items()):
            one = reader.read(photo, fiber, bend)
            lost = float(np.hypot(one.noise, photos.compression.max()))
            measured.append(replace(one, noise=lost))
    return measured


def fit_rig(
    scene: Scene,
    model: LineModel,
    measurements: list[Measurement],
    start: Array | None = None,
) -> Calibration:
    """Return the best material, powers and gains, with their errors.

    The material of ``scene`` is what is known, and where the fit starts unless ``start`` is given.
    Errors of ``model`` are fitted with the rest; there is a photograph at each of its bends.

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
    before = model.space.of(scene)
    problem = CalibrationResiduals(model, measurements, before)
    x = problem.start(before if start is None else start)
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
    channels = len(scene.palette.channels)
    powers, gains = np.full(scene.lamp_count, np.nan), np.full(channels, np.nan)
    powers[problem.fibers], gains[problem.channels] = problem.unpack(x)
    residuals = problem.residuals(x)[: problem.rows]
    return Calibration(
        space=problem.space,
        # The fit ends a little inside its bounds.
        material=np.where(
            x[problem.material] < low[problem.material] + 2e-6,
            low[problem.material],
            x[problem.material],
        ),
        power=powers,
        gain=gains,
        tilt=x[problem.tilt],
        vignetting=float(x[problem.vignetting]),
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
