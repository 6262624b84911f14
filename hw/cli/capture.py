"""``tactilux hw capture``: a sweep into a folder; and the live sweep of ``tactilux check``."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hw.camera.dewarp import Dewarp, load_lens
from hw.camera.opencv_camera import LockedSettings, OpenCVCamera
from hw.camera.photo import check_photo
from hw.camera.photo_set import PhotoSet, photo_set, take_sweep
from hw.camera.self_test import self_test
from hw.cli.wiring import Wiring
from hw.leds.fiber_lights import interruptible
from optimize.design.design import Array, Design
from optimize.design.design_file import load_design
from optimize.ui.console import Meter, reserved_stdout
from optimize.ui.output import OutputError, fresh_directory, write_manifest
from render.scene.schema import Scene, load_scene

SETTLE = 0.15
"""Seconds between setting a light and photographing it."""
TEST_LEVEL = 0.3
"""Power of all LEDs of one color in the self-test."""


@dataclass(frozen=True)
class Shot:
    """How photographs are taken, as the options of the command line say."""

    camera: int
    lens: Path | None = None
    exposure: float | None = None
    gain: float | None = None
    white_balance: float | None = None
    frames: int = 4


def sweep_photos(
    scene: Scene, design: Design, shot: Shot, wiring: Wiring, *, white: float | None = None
) -> dict[str, Array]:
    """Return the photographs of a sweep, after the self-tests.

    Arguments:
        scene: whose camera the photographs must fit.
        design: whose fibers are lit.
        shot: camera and its settings.
        wiring: of the lights.
        white: light every fiber in all three channels with this power instead of the design's.
    """
    prepare = Dewarp(load_lens(shot.lens), scene) if shot.lens else np.asarray
    locked = LockedSettings(shot.exposure, shot.gain, shot.white_balance)
    power = design.power * wiring.scale
    if white is not None:
        power = np.any(design.power, axis=1)[:, None] * np.full(3, white)
    with (
        interruptible(),
        closing(OpenCVCamera(shot.camera, locked)) as camera,
        wiring.lights(len(design.phi)) as lights,
        Meter("Photographing") as meter,
    ):
        first = prepare(camera.capture())
        check_photo(first, scene.camera.rows, scene.camera.columns, "the photograph")
        self_test(camera, lights, TEST_LEVEL * wiring.scale, SETTLE)
        # All fibers in all colors at once would draw three times what the design does.
        return take_sweep(
            camera,
            lights,
            power,
            frames=shot.frames,
            settle=SETTLE,
            together=white is None,
            prepare=prepare,
            progress=meter,
        )


def live(scene: Scene, design: Design, shot: Shot, wiring: Wiring) -> PhotoSet:
    """Return a sweep for the check."""
    photos = sweep_photos(scene, design, shot, wiring)
    for name, photo in photos.items():
        check_photo(photo, scene.camera.rows, scene.camera.columns, name)
    return photo_set(photos)


def run(
    scene_name: str,
    path: Path,
    shot: Shot,
    wiring: Wiring,
    *,
    out: Path,
    white: float | None,
) -> None:
    """Photograph a sweep of the design in ``path`` into the folder ``out``."""
    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        design = load_design(path, scene)
        photos = sweep_photos(scene, design, shot, wiring, white=white)
        save_photos(photos, out)
        stream.write(f"{len(photos)} photographs: {out}\n")


def save_photos(photos: dict[str, Array], out: Path) -> None:
    """Write photographs, counts ``(row, column, 3)``, as 16-bit ``.npy`` files into a new folder.

    Raises:
        OutputError: the folder holds something else.
    """
    try:
        with fresh_directory(out) as folder:
            for name, photo in photos.items():
                np.save(folder / f"{name}.npy", np.rint(photo * (65535 / 255)).astype(np.uint16))
            write_manifest(folder, {"photographs": len(photos)})
    except OSError as error:
        raise OutputError(
            f"{out} cannot be written ({error.strerror}): choose another place with --out",
            field="out",
            value=str(out),
        ) from None
