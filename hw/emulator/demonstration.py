"""The steps of the demonstration on an emulated rig: light it, sweep it, break it and check it.

Everything but the hardware is real: the serial driver talks to a pseudo-terminal, photographs go
through the same readers, and the rig's true values are known to the emulated camera alone.
"""

from __future__ import annotations

import contextlib
import itertools
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hw.calibration.material import material_space
from hw.calibration.reference_lines import Setup
from hw.camera.photo_set import PhotoSet, photo_set, save_photos, take_sweep
from hw.camera.self_test import self_test
from hw.check.commission import commission
from hw.check.diagnosis import Diagnosis
from hw.check.prediction import SiteSpots, predict
from hw.check.rig_tolerances import rig_tolerances
from hw.check.sweep_check import check_sweep, swapped_powers
from hw.emulator.emulated_board import EmulatedBoard
from hw.emulator.emulated_camera import EmulatedCamera
from hw.emulator.rig import TrueParameters, rendered_images
from hw.leds import ProtocolName
from hw.leds.channels import ChannelMap, PowerLimits
from hw.leds.fiber_lights import FiberLights, sweep
from hw.leds.ports import open_board
from optimize.design import FULL_MILLIAMPERES, Design
from optimize.ui.console import ProgressBar, note
from render.arrays import Array
from render.progress import Progress
from render.scene import Scene
from surrogate.runtime import Checker

SWEEPS = ("flat", "bent")
SINGLE_FIBER_COUNTS = 210.0
"""Counts of the brightest photograph of one fiber."""
BRIGHTEST = 99.9
"""Percentile of pixels that stands for the brightest."""


def calibration_bends(scene: Scene) -> Array:
    """Return the bends ``(bend,)`` rad at which a rig is photographed: a rigid one flat alone."""
    return np.array([0.0] if scene.bending.rigid else [0.0, np.pi / 2])


def calibration_fibers(scene: Scene) -> list[range]:
    """Return the fibers that are photographed at each of `calibration_bends`."""
    fibers, bends = range(scene.lamp_count), len(calibration_bends(scene))
    return [fibers[bend::bends] for bend in range(bends)]


@dataclass(eq=False)
class EmulatedRig:
    """An emulated rig, switched on.

    ``images`` ``(bend, fiber, row, column[, channel])`` are true radiance per unit power; ``keep``
    is the folder for its photographs.
    """

    scene: Scene
    design: Design
    truth: TrueParameters
    images: NDArray[np.float32]
    board: EmulatedBoard
    lights: FiberLights
    keep: Path | None = None

    def camera(self, bend: int = 0, truth: TrueParameters | None = None) -> EmulatedCamera:
        """Return the camera at a bend's index, with a fault where a changed ``truth`` has one."""
        known = truth or self.truth
        return EmulatedCamera(
            self.scene, self.images[bend], self.board, known.gain, known.power,
            known.imperfections, known.seed,
        )  # fmt: skip

    def photos(
        self,
        name: str,
        camera: EmulatedCamera,
        power: Array,
        *,
        frames: int = 1,
        together: bool = False,
    ) -> PhotoSet:
        """Return a sweep, which is also kept under its name."""
        palette = self.scene.palette
        taken = take_sweep(
            camera, self.lights, power, palette, frames=frames, settle=0.0, together=together
        )
        if self.keep is not None:
            save_photos(taken, self.keep / name.replace(" ", "-"))
        return photo_set(taken)

    def calibration_sets(self) -> list[PhotoSet]:
        """Return photographs of every fiber with all its LEDs, each at one of its bends.

        The bends are those of `calibration_bends`.
        """
        sets = []
        for bend, fibers in enumerate(calibration_fibers(self.scene)):
            power = np.zeros(self.design.drive.shape)
            power[fibers] = 1.0
            sets.append(self.photos(SWEEPS[bend], self.camera(bend), power))
        return sets

    def color_sets(self) -> list[PhotoSet]:
        """Return sweeps of the flat pad in each LED color alone."""
        fibers, names = calibration_fibers(self.scene)[0], self.scene.palette.names
        lit = np.isin(np.arange(len(self.design.phi)), fibers)[:, None]
        return [self.photos(name, self.camera(), lit * only)
                for name, only in zip(names, np.eye(len(names)), strict=True)]  # fmt: skip

    def additive_set(self) -> PhotoSet:
        """Return a dim sweep of all LEDs and all fibers together, which tests linearity."""
        power = np.zeros(self.design.drive.shape)
        power[:, : self.scene.palette.led_count] = self.dim_power()
        return self.photos("additive", self.camera(0), power, together=True)

    def dim_power(self) -> float:
        """Return a power at which all fibers together do not clip, in (0, 1].

        They are as bright then as the brightest one alone at full power.
        """
        together = _white_light(self.truth, self.images)[0].sum(axis=0)
        brightest = self.truth.gain * float(np.percentile(together, BRIGHTEST))
        return min(SINGLE_FIBER_COUNTS / brightest, 1.0)


@contextlib.contextmanager
def switched_on(
    scene: Scene,
    design: Design,
    truth: TrueParameters,
    images: NDArray[np.float32],
    keep: Path | None = None,
) -> Iterator[EmulatedRig]:
    """Plug the rig's board in and open its lights; all LEDs are off at the end.

    Arguments are those of `EmulatedRig`.
    """
    channels = ChannelMap.straight(scene.lamp_count, colors=scene.palette.led_count)
    leds = channels.needed
    # What all LEDs of the board draw.
    supply = PowerLimits(total_milliamperes=3 * leds * FULL_MILLIAMPERES)
    with (
        tempfile.TemporaryDirectory() as place,
        EmulatedBoard(Path(place) / "ttyEMU0", leds=leds) as board,
    ):
        connect = partial(open_board, str(board.port), ProtocolName.LINES, leds=leds)
        with FiberLights(connect, channels, supply) as lights:
            yield EmulatedRig(scene, design, truth, images, board, lights, keep)
        if board.levels.any():
            raise AssertionError("an LED stayed on")


def single_exposure(truth: TrueParameters, images: NDArray[np.float32]) -> float:
    """Return the exposure that puts the brightest single fiber at `SINGLE_FIBER_COUNTS`."""
    light = _white_light(truth, images)
    return SINGLE_FIBER_COUNTS / float(np.percentile(light, BRIGHTEST, axis=(2, 3)).max())


def _white_light(truth: TrueParameters, images: NDArray[np.float32]) -> Array:
    """Return the light of all LEDs of each fiber in its brightest channel.

    It is ``(bend, fiber, row, column)``.
    """
    white = truth.imperfections.response.sum(axis=0)
    light = images * white.max() if images.ndim == 4 else (images * white).max(axis=-1)
    return np.asarray(light * truth.power[:, None, None])


FRAMES = 4
"""Photographs that are averaged for each fiber of the checks."""
FAULTY = (4, 9, 12)
"""Fibers that are dead, weak and wrongly colored; the first three that are lit where the design
does not light these."""
DRIFT = 0.03
"""Relative change of powers between two starts."""


def render_rig(
    scene: Scene, truth: TrueParameters, design: Design, rig_samples: int
) -> NDArray[np.float32]:
    """Return the rig's light: all fibers on the flat pad, those to be photographed on the bent."""
    note("Rendering what the camera of a rig with secrets sees: material, powers, directions")
    # Checks look at all fibers on the flat pad.
    _, *bent = calibration_fibers(scene)
    with ProgressBar("Rendering the rig") as bar:
        return rendered_images(
            Setup(scene, design.phi, calibration_bends(scene)), truth,
            [range(scene.lamp_count), *bent], samples=rig_samples, progress=bar,
        )  # fmt: skip


def set_and_sweep(rig: EmulatedRig) -> None:
    """Show the design on the rig's board, then one fiber after the other, and test the camera."""
    note(f"Emulated LED board on {rig.board.port}; setting the design, then sweeping")
    shots = rig.scene.palette.in_shots(rig.design.drive)
    for shot in shots:
        rig.lights.set(shot)
        if not rig.board.wait_for(rig.lights.channels.levels(shot, rig.lights.limits)):
            raise AssertionError("the board does not show the design")
    lit = list(sweep(rig.lights, shots.max(axis=0)))
    self_test(rig.camera(), rig.lights, rig.dim_power(), 0.0, rig.scene.palette.one_shot)
    note(f"  {len(lit)} fibers lit one after the other; dark frame and channel order are right")


def check_faults(rig: EmulatedRig, checker: Checker) -> dict[str, Diagnosis]:
    """Commission the rig, check it, then check it with one fault of each kind."""
    spots = SiteSpots(rig.scene, 0.0)
    prediction = predict(checker, rig.design.phi, rig.design.drive, 0.0, rig.scene.palette.matrix)
    noise = rig.truth.imperfections.noise / np.sqrt(spots.counts * FRAMES)
    known = rig_tolerances(sweep=True, starts=1, noise=noise)

    def colors(name: str, camera: EmulatedCamera, power: Array) -> Array:
        photos = rig.photos(name, camera, power, frames=FRAMES)
        return photos.stacked(prediction.lit, spots.colors)

    healthy = colors("commission", rig.camera(), rig.design.drive)
    record = commission(prediction, healthy, rig.scene, 0.0)
    prediction = replace(prediction, response=record.response)
    found, faulty = {}, _faulty(rig, record.response)
    with ProgressBar("Checking") as bar:
        for number, (name, camera, power) in enumerate(faulty):
            found[name] = check_sweep(prediction, colors(name, camera, power), known, record.ratio)
            bar(Progress(number + 1, len(faulty)))
    return found


def _faulty(rig: EmulatedRig, response: Array) -> list[tuple[str, EmulatedCamera, Array]]:
    """Return the rig at later starts: name, camera with drift and noise of its own, powers.

    Colors are swapped where ``response`` ``(color, channel)`` says that the camera sees it.
    """
    starts = itertools.count(1)

    def weaker(fiber: int, factor: float) -> EmulatedCamera:
        start = next(starts)
        rng = np.random.default_rng([rig.truth.seed, start])
        power = rig.truth.power * np.exp(DRIFT * rng.standard_normal(len(rig.truth.power)))
        power[fiber] *= factor
        return replace(
            rig.camera(truth=replace(rig.truth, power=power)), seed=rig.truth.seed + start
        )

    drive = rig.design.drive
    lit = np.flatnonzero(drive.any(axis=1)).tolist()
    dead, weak, wrong = (
        FAULTY if set(FAULTY) <= set(lit) else (lit[min(one, len(lit) - 1)] for one in range(3))
    )
    found = [
        ("healthy", weaker(0, 1.0), drive),
        (f"fiber {dead} dead", weaker(dead, 0.0), drive),
        (f"fiber {weak} at half power", weaker(weak, 0.5), drive),
    ]
    rolled = [np.roll(drive[wrong], step) for step in range(1, drive.shape[1])]
    others = swapped_powers(drive[wrong], response)
    visible = [one for one in rolled if any(np.array_equal(one, other) for other in others)]
    if visible:
        swapped = drive.copy()
        swapped[wrong] = visible[0]
        found.append((f"fiber {wrong} with swapped colors", weaker(0, 1.0), swapped))
    return found


def compare_with_truth(
    scene: Scene, result: dict[str, Any], truth: TrueParameters
) -> list[dict[str, Any]]:
    """Return the truth beside what was found."""
    assert truth.material is not None  # else there is nothing to calibrate
    space, known = material_space(scene), result["material"]
    values = zip(space.names, space.told(truth.material).tolist(), strict=True)
    compared = [
        (name, true, known[name]["value"], known[name]["interval"]) for name, true in values
    ]
    if result["response"] is not None:
        response, palette = truth.imperfections.response, scene.palette
        # Relative to the value that was found to be the largest.
        largest = np.argmax([result["response"][color]["value"] for color in palette.names])
        response = response / response.flat[largest]
        for color, of_color in zip(palette.names, response, strict=True):
            found = result["response"][color]
            compared += zip(
                [f"{color} in {channel}" for channel in palette.channels], of_color.tolist(),
                found["value"], found["interval"], strict=True,
            )  # fmt: skip
    return [
        {"name": name, "true": true, "found": found, "error": found / true - 1,
         "inside": low <= true <= high}
        for name, true, found, (low, high) in compared
    ]  # fmt: skip
