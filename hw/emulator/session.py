"""An emulated rig, switched on: its board on a serial port, its camera, and what it photographs."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hw.camera.photo_set import PhotoSet, photo_set, save_photos, take_sweep
from hw.emulator.emulated_board import EmulatedBoard
from hw.emulator.emulated_camera import EmulatedCamera
from hw.emulator.rig import TrueParameters
from hw.leds import ProtocolName
from hw.leds.channels import ChannelMap, PowerLimits
from hw.leds.fiber_lights import FiberLights
from hw.leds.ports import open_board
from optimize.design import Array
from tactilux import Design, Scene

BENDS = np.array([0.0, np.pi / 2])
CALIBRATION_FIBERS = (slice(0, None, 2), slice(1, None, 2))
"""Fibers that are photographed for calibration at each of `BENDS`."""
ADDITIVE_SCALE = 0.15
"""Power of the sweep that tests linearity: all fibers together must not clip."""
SUPPLY = PowerLimits(total_milliamperes=2000.0)
SINGLE_FIBER_COUNTS = 210.0
"""Counts of the brightest photograph of one fiber."""


@dataclass(eq=False)
class EmulatedRig:
    """An emulated rig, switched on.

    Arguments:
        scene: what is known about it.
        design: its directions and colors.
        truth: what is not known.
        images: ``(bend, fiber, row, column)`` true radiance per unit power.
        board: its board; lights: of its fibers.
        keep: folder for its photographs, None if they are not kept.
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
        taken = take_sweep(camera, self.lights, power, frames=frames, settle=0.0, together=together)
        if self.keep is not None:
            save_photos(taken, self.keep / name.replace(" ", "-"))
        return photo_set(taken)

    def calibration_sets(self) -> list[PhotoSet]:
        """Return 20 photographs in white, half of the fibers on the flat pad, half on the bent."""
        sets = []
        for bend, (name, fibers) in enumerate(
            zip(("flat", "bent"), CALIBRATION_FIBERS, strict=True)
        ):
            power = np.zeros((len(self.design.phi), 3))
            power[fibers] = 1.0
            sets.append(self.photos(name, self.camera(bend), power))
        return sets

    def additive_set(self) -> PhotoSet:
        """Return a dim sweep in white and all fibers together, which tests linearity."""
        white = np.ones((len(self.design.phi), 3))
        return self.photos("additive", self.camera(0), ADDITIVE_SCALE * white, together=True)


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
    leds = scene.fibers.count
    with (
        tempfile.TemporaryDirectory() as place,
        EmulatedBoard(Path(place) / "ttyEMU0", leds=leds) as board,
    ):
        connect = partial(open_board, str(board.port), ProtocolName.LINES, leds=leds)
        with FiberLights(connect, ChannelMap.straight(leds), SUPPLY) as lights:
            yield EmulatedRig(scene, design, truth, images, board, lights, keep)
        if board.levels.any():
            raise AssertionError("an LED stayed on")


def single_exposure(truth: TrueParameters, images: NDArray[np.float32]) -> float:
    """Return the exposure that puts the brightest single fiber at `SINGLE_FIBER_COUNTS`."""
    light = images * truth.power[:, None, None] * max(truth.imperfections.gain)
    return SINGLE_FIBER_COUNTS / float(np.percentile(light, 99.9, axis=(2, 3)).max())
