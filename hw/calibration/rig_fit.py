"""From photographs to a calibration: the steps in their order, for real and emulated rigs alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hw.calibration.fit import Calibration, calibrate
from hw.calibration.material import Material
from hw.calibration.material_table import MaterialTable, material_table
from hw.calibration.measurement import LineReader, Measurement
from hw.calibration.model_error import ErrorModes, field_modes
from hw.calibration.reference_lines import reference_lines
from hw.calibration.surrogate_correction import SurrogateCorrection, surrogate_correction
from hw.camera.linearity import Linearity, linearity
from hw.camera.photo_set import PhotoSet
from hw.errors import CalibrationError
from render.arrays import Array
from render.preview.diffuser.cache import cache_folder
from render.scene.schema import Scene
from surrogate.runtime.checker import Checker

DISCREPANCY = 0.015
"""Relative error of the corrected preview where the surrogate says nothing about it."""


@dataclass(frozen=True, eq=False)
class LineModel:
    """What photographs are compared with.

    Arguments:
        table: light at the reference lines for any material.
        correction: what the surrogate adds to it.
        log_correction: the same at the lines, ``(bend, fiber, point)``.
        modes: log errors that it may still have.
    """

    table: MaterialTable
    correction: SurrogateCorrection
    log_correction: Array
    modes: ErrorModes

    def log_light(self, material: Material) -> Array:
        """Return log radiance per unit power at the reference lines, ``(bend, fiber, point)``."""
        return self.table.log_light(material.array()) + self.log_correction


def line_model(
    scene: Scene,
    checker: Checker,
    phi: Array,
    bends: Array,
    progress: Callable[[int, int], None] | None = None,
) -> LineModel:
    """Return the model of the reference lines.

    The table is drawn when it is first needed, which takes minutes, and kept in the user's cache.

    Arguments:
        scene: the surrogate's own.
        checker: the surrogate.
        phi: ``(fiber,)`` rad.
        bends: ``(bend,)`` rad.
        progress: called with materials drawn and all of them.
    """
    table = material_table(scene, phi, bends, folder=cache_folder(), progress=progress)
    correction = surrogate_correction(scene, checker, phi, bends)
    position = reference_lines(scene).position
    log_correction = np.stack(
        [
            np.stack([correction.log_ratio(bend, f, position[f]) for f in range(len(phi))])
            for bend in range(len(bends))
        ]
    )
    error = np.hypot(np.hypot(DISCREPANCY, correction.left), table.scatter())
    modes = field_modes(error, len(phi))
    return LineModel(table, correction, log_correction, modes)


def require_linearity(sets: list[PhotoSet], noise: float) -> Linearity:
    """Return the test of the first sweep that also shows all fibers together, and require it.

    Raises:
        CalibrationError: light does not add up, or no sweep shows all fibers together.
    """
    for photos in sets:
        if photos.together is not None:
            found = linearity(np.stack(list(photos.alone.values())), photos.together, noise)
            found.require()
            return found
    raise CalibrationError(
        "no sweep shows all fibers together, so the camera cannot be tested for linearity: capture "
        "one with `tactilux hw capture` and give it with --linearity",
        field="linearity",
    )


def measure(scene: Scene, sets: list[PhotoSet], bends: Array, noise: float) -> list[Measurement]:
    """Return the reference lines of all photographs; ``sets`` are in the order of ``bends``."""
    reader = LineReader(scene, bends, noise)
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
    """Return the calibration of ``scene`` to ``measurements``; it starts at the scene's own."""
    dark = [one.fiber for one in measurements if not one.channels or one.used.sum() < 10]
    if dark:
        raise CalibrationError(
            f"fiber {dark[0]} lights too few points of its reference lines: mend or leave out that "
            "fiber, or raise the exposure",
            field="fiber",
            value=dark,
        )
    return calibrate(
        model.table,
        model.log_correction,
        model.modes,
        measurements,
        start or Material.of(scene),
        scene.pad.roughness,
    )
