"""``tactilux hw capture``: a sweep into a folder; and the live sweep of ``tactilux check``."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from hw.cli.options import Lens, SceneOption, Wiring, grouped
from optimize.cli.options import DesignArgument
from optimize.ui.console import ProgressBar, reserved_stdout

if TYPE_CHECKING:
    from hw.camera.opencv_camera import LockedSettings
    from hw.camera.photo_set import PhotoSet
    from optimize.design import Design
    from render.arrays import Array
    from render.scene import Scene

SETTLE = 0.15
"""Seconds between setting a light and photographing it."""
TEST_LEVEL = 0.3
"""Power of all LEDs of one color in the self-test."""


@grouped
def run(
    path: DesignArgument,
    out: Annotated[Path, Option(help="Folder to write.")],
    scene_name: SceneOption = "finger20",
    camera: Annotated[int, Option(min=0, help="Number of the camera.")] = 0,
    lens: Lens = None,
    exposure: Annotated[float | None, Option(help="In the driver's own unit.")] = None,
    gain: Annotated[float | None, Option(help="In the driver's own unit.")] = None,
    white_balance: Annotated[float | None, Option(help="In kelvin.")] = None,
    frames: Annotated[int, Option(min=1, help="Photographs that are averaged.")] = 4,
    white: Annotated[
        float | None,
        Option(min=0.0, max=1.0, help="Light all LEDs of each fiber with this power."),
    ] = None,
    color: Annotated[
        str | None,
        Option(help="Light LEDs of this color alone, at the power of --white or 1."),
    ] = None,
    *,
    wiring: Wiring,
) -> None:
    """Photograph the dark, every fiber alone, and all together."""
    from hw.camera.opencv_camera import LockedSettings
    from hw.camera.photo_set import save_photos
    from optimize.design import load_design
    from render.scene import load_scene

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        design = load_design(path, scene)
        locked = LockedSettings(exposure, gain, white_balance)
        only = None
        if white is not None or color is not None:
            only = only_light(white, color, scene.palette.one_shot.names)
        photos = sweep_photos(scene, design, camera, wiring, lens, locked, frames, only)
        save_photos(photos, out, dewarped=lens is not None)
        stream.write(f"{len(photos)} photographs: {out}\n")


def sweep_photos(
    scene: Scene,
    design: Design,
    source: int,
    wiring: Wiring,
    lens: Path | None,
    locked: LockedSettings | None,
    frames: int,
    only: Array | None = None,
) -> dict[str, Array]:
    """Return the photographs of a sweep, after the self-tests.

    ``only`` ``(LED,)`` is the light of every fiber instead of the design's, in all shots.
    """
    import numpy as np

    from hw.camera.lens import load_lens
    from hw.camera.opencv_camera import OpenCVCamera
    from hw.camera.photo_set import check_photo, take_sweep
    from hw.camera.projection import Dewarp
    from hw.camera.self_test import self_test

    prepare = Dewarp(load_lens(lens), scene) if lens else np.asarray
    power, palette = design.drive * wiring.scale, scene.palette
    if only is not None:
        power = np.zeros(design.drive.shape)
        power[np.any(design.drive, axis=1), : palette.led_count] = only
    with (
        closing(OpenCVCamera(source, locked, channels=len(palette.one_shot.channels))) as camera,
        wiring.lights(len(design.phi), palette.led_count) as lights,
        ProgressBar("Photographing") as bar,
    ):
        first = prepare(camera.capture())
        check_photo(first, scene.camera.rows, scene.camera.columns, "the photograph")
        self_test(camera, lights, TEST_LEVEL * wiring.scale, SETTLE, palette.one_shot)
        # All fibers in all colors at once would draw several times what the design does.
        return take_sweep(
            camera,
            lights,
            power,
            palette,
            frames=frames,
            settle=SETTLE,
            together=only is None,
            prepare=prepare,
            progress=bar,
        )


def only_light(white: float | None, color: str | None, names: tuple[str, ...]) -> Array:
    """Return the light ``(color,)`` that stands for the design's: all LEDs, or one color of it.

    ``names`` are those of the LED colors.

    Raises:
        CaptureError: there is no such color.
    """
    import numpy as np

    from hw.errors import CaptureError

    power = 1.0 if white is None else white
    if color is None:
        return np.full(len(names), power)
    if color not in names:
        raise CaptureError(f"--color is {color}, allowed: {', '.join(names)}", field="color")
    return np.where(np.array(names) == color, power, 0.0)


def live(
    scene: Scene, design: Design, source: int, wiring: Wiring, lens: Path | None, frames: int
) -> PhotoSet:
    """Return a sweep for the check."""
    from hw.camera.photo_set import check_photo, photo_set

    photos = sweep_photos(scene, design, source, wiring, lens, None, frames)
    for name, photo in photos.items():
        check_photo(photo, scene.camera.rows, scene.camera.columns, name)
    return photo_set(photos)
