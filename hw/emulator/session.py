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

from hw.camera.photo_set import PhotoSet, photo_set, take_sweep
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
    """An emulated rig, switched on; ``images`` are ``(bend, fiber, row, column)`` true radiance."""

    scene: Scene
    design: Design
    truth: TrueParameters
    images: NDArray[np.float32]
    board: EmulatedBoard
    lights: FiberLights

    def camera(self, bend: int = 0, truth: TrueParameters | None = None) -> EmulatedCamera:
        """Return the camera at a bend's index, with a fault where a changed ``truth`` has one."""
        known = truth or self.truth
        return EmulatedCamera(
            self.scene, self.images[bend], self.board, known.gain, known.power,
            known.imperfections, known.seed,
        )  # fmt: skip

    def photos(
        self, camera: EmulatedCamera, power: Array, *, frames: int = 1, together: bool = False
    ) -> PhotoSet:
        """Return a sweep."""
        taken = take_sweep(camera, self.lights, power, frames=frames, settle=0.0, together=together)
        return photo_set(taken)

    def calibration_sets(self) -> list[PhotoSet]:
        """Return 20 photographs in white, half of the fibers on the flat pad, half on the bent."""
        sets = []
        for bend, fibers in enumerate(CALIBRATION_FIBERS):
            power = np.zeros((len(self.design.phi), 3))
            power[fibers] = 1.0
            sets.append(self.photos(self.camera(bend), power))
        return sets

    def additive_set(self) -> PhotoSet:
        """Return a dim sweep in white and all fibers together, which tests linearity."""
        white = np.ones((len(self.design.phi), 3))
        return self.photos(self.camera(0), ADDITIVE_SCALE * white, together=True)


@contextlib.contextmanager
def switched_on(
    scene: Scene, design: Design, truth: TrueParameters, images: NDArray[np.float32]
) -> Iterator[EmulatedRig]:
    """Plug the rig's board in and open its lights; all LEDs are off at the end.

    Arguments:
        scene: what is known about the rig.
        design: its directions and colors.
        truth: what is not known.
        images: ``(bend, fiber, row, column)`` true radiance per unit power.
    """
    leds = scene.fibers.count
    with (
        tempfile.TemporaryDirectory() as place,
        EmulatedBoard(Path(place) / "ttyEMU0", leds=leds) as board,
    ):
        connect = partial(open_board, str(board.port), ProtocolName.LINES, leds=leds)
        with FiberLights(connect, ChannelMap.straight(leds), SUPPLY) as lights:
            yield EmulatedRig(scene, design, truth, images, board, lights)
        if board.levels.any():
            raise AssertionError("an LED stayed on")


def single_exposure(truth: TrueParameters, images: NDArray[np.float32]) -> float:
    """Return the exposure that puts the brightest single fiber at `SINGLE_FIBER_COUNTS`."""
    light = images * truth.power[:, None, None] * max(truth.imperfections.gain)
    return SINGLE_FIBER_COUNTS / float(np.percentile(light, 99.9, axis=(2, 3)).max())
