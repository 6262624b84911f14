"""The steps of the demonstration on an emulated rig: light it, sweep it, break it and check it.

Everything but the hardware is real: the serial driver talks to a pseudo-terminal, photographs go
through the same readers, and the rig's true values are known to the emulated camera alone.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hw.calibration.material import NAMES, PER_UNIT
from hw.calibration.reference_lines import Setup
from hw.camera.self_test import self_test
from hw.check.commission import commission
from hw.check.diagnosis import Diagnosis
from hw.check.prediction import predict
from hw.check.rig_tolerances import rig_tolerances
from hw.check.site_colors import SiteSpots
from hw.check.sweep_check import check_sweep
from hw.emulator.emulated_camera import EmulatedCamera
from hw.emulator.rig import TrueParameters, rendered_images
from hw.emulator.session import ADDITIVE_SCALE, BENDS, CALIBRATION_FIBERS, EmulatedRig
from hw.leds.fiber_lights import sweep
from optimize.design import Design
from optimize.ui.console import ProgressBar, note
from render.arrays import Array
from render.progress import Progress
from render.scene import Scene
from surrogate.runtime import Checker

FRAMES = 4
"""Photographs that are averaged for each fiber of the checks."""
DRIFT = 0.03
"""Relative change of powers between two starts."""


def render_rig(
    scene: Scene, truth: TrueParameters, design: Design, rig_samples: int
) -> NDArray[np.float32]:
    """Return the rig's light: all fibers on the flat pad, those to be photographed on the bent."""
    note("Rendering what the camera of a rig with secrets sees: material, powers, directions")
    fibers = range(scene.fibers.count)
    with ProgressBar("Rendering the rig") as bar:
        return rendered_images(
            Setup(scene, design.phi, BENDS), truth, [fibers, fibers[CALIBRATION_FIBERS[1]]],
            samples=rig_samples, progress=bar,
        )  # fmt: skip


def set_and_sweep(rig: EmulatedRig) -> None:
    """Show the design on the rig's board, then one fiber after the other, and test the camera."""
    note(f"Emulated LED board on {rig.board.port}; setting the design, then sweeping")
    rig.lights.set(rig.design.power)
    if not rig.board.wait_for((255 * rig.design.power).astype(np.uint8)):
        raise AssertionError("the board does not show the design")
    lit = list(sweep(rig.lights, rig.design.power))
    self_test(rig.camera(), rig.lights, ADDITIVE_SCALE, 0.0)
    note(f"  {len(lit)} fibers lit one after the other; dark frame and channel order are right")


def check_faults(rig: EmulatedRig, checker: Checker) -> dict[str, Diagnosis]:
    """Commission the rig, check it, then check it with one fault of each kind."""
    spots = SiteSpots(rig.scene, 0.0)
    prediction = predict(checker, rig.design.phi, rig.design.power, 0.0)
    noise = rig.truth.imperfections.noise / np.sqrt(spots.counts * FRAMES)
    known = rig_tolerances(sweep=True, starts=1, noise=noise)

    def colors(name: str, camera: EmulatedCamera, power: Array) -> Array:
        photos = rig.photos(name, camera, power, frames=FRAMES)
        return photos.stacked(len(rig.design.phi), spots.colors)

    healthy = colors("commission", rig.camera(), rig.design.power)
    record = commission(prediction, healthy, rig.scene.hash, 0.0)
    found = {}
    with ProgressBar("Checking") as bar:
        for number, (name, camera, power) in enumerate(_faulty(rig)):
            found[name] = check_sweep(prediction, colors(name, camera, power), known, record.ratio)
            bar(Progress(number + 1, 4))
    return found


def _faulty(rig: EmulatedRig) -> list[tuple[str, EmulatedCamera, Array]]:
    """Return the rig at later starts: name, camera with drift and noise of its own, powers."""
    starts = itertools.count(1)

    def weaker(fiber: int, factor: float) -> EmulatedCamera:
        start = next(starts)
        rng = np.random.default_rng([rig.truth.seed, start])
        power = rig.truth.power * np.exp(DRIFT * rng.standard_normal(len(rig.truth.power)))
        power[fiber] *= factor
        return replace(
            rig.camera(truth=replace(rig.truth, power=power)), seed=rig.truth.seed + start
        )

    swapped = rig.design.power.copy()
    swapped[12] = np.roll(swapped[12], 1)
    return [
        ("healthy", weaker(0, 1.0), rig.design.power),
        ("fiber 4 dead", weaker(4, 0.0), rig.design.power),
        ("fiber 9 at half power", weaker(9, 0.5), rig.design.power),
        ("fiber 12 with swapped colors", weaker(0, 1.0), swapped),
    ]


def compare_with_truth(result: dict[str, Any], truth: TrueParameters) -> list[dict[str, Any]]:
    """Return the truth beside what was found."""
    rows = []
    for name, true in zip(NAMES, (PER_UNIT * truth.material.array()).tolist(), strict=True):
        found, (low, high) = result["material"][name]["value"], result["material"][name]["interval"]
        rows.append({"name": name, "true": true, "found": found, "error": found / true - 1,
                     "inside": low <= true <= high})  # fmt: skip
    return rows
