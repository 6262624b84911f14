"""The photographs of a sweep: the dark frame, every fiber alone, all together; live or in a folder.

A folder holds ``dark``, ``all`` and ``fiber-00``, ``fiber-01``, ... as PNG, JPEG or ``.npy``;
``hw/README.md`` describes it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hw.camera.opencv_camera import CameraDevice
from hw.camera.photo import DARK_FRAMES, MAX_DARK_COUNTS, check_photo, linear, read_photo
from hw.errors import CaptureError
from hw.leds.fiber_lights import FiberLights, sweep
from render.arrays import Array
from render.progress import Clock, OnProgress

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy")


@dataclass(frozen=True, eq=False)
class PhotoSet:
    """Linear counts ``(row, column, 3)`` each, the dark frame already subtracted.

    Arguments:
        alone: by number of the fiber.
        together: all fibers at once, None when it was not taken.
    """

    alone: dict[int, Array]
    together: Array | None

    def stacked(self, fibers: int, of: Callable[[Array], Array]) -> Array:
        """Return ``of`` every photograph, ``(fiber, ...)``.

        Raises:
            CaptureError: the photograph of some fiber is missing.
        """
        missing = [fiber for fiber in range(fibers) if fiber not in self.alone]
        if missing:
            raise CaptureError(
                f"the sweep has no photograph of fiber {missing[0]} ({len(missing)} are missing), "
                f"allowed: all of 0 to {fibers - 1}; capture the sweep again",
                field="capture",
                value=missing,
            )
        return np.stack([of(self.alone[fiber]) for fiber in range(fibers)])


def take_sweep(
    camera: CameraDevice,
    lights: FiberLights,
    power: Array,
    *,
    frames: int = 1,
    settle: float = 0.1,
    together: bool = True,
    prepare: Callable[[Array], Array] = np.asarray,
    progress: OnProgress | None = None,
) -> dict[str, Array]:
    """Return photographs by name as a folder would hold them, counts ``(row, column, 3)``.

    Arguments:
        camera: of the rig.
        lights: of the rig.
        power: ``(fiber, 3)`` in [0, 1]; fibers without power are left out.
        frames: photographs that are averaged.
        settle: seconds between setting a light and photographing it.
        together: also photograph all fibers at once.
        prepare: done to every photograph first, a dewarp for example.
        progress: told of every photograph.
    """
    lights.off()
    lights.hold(settle)
    total = int((power.max(axis=1) > 0).sum()) + 1 + together
    photos = {"dark": prepare(camera.capture(DARK_FRAMES))}
    check_dark(photos["dark"], "the dark frame")
    if together:
        lights.set(power)
        lights.hold(settle)
        photos["all"] = prepare(camera.capture(frames))
    clock = Clock(total, progress)
    clock.skip(len(photos))
    for fiber in sweep(lights, power, settle):
        photos[f"fiber-{fiber:02d}"] = prepare(camera.capture(frames))
        clock.tick()
    return photos


def photo_set(photos: dict[str, Array], gamma: float = 1.0) -> PhotoSet:
    """Return photographs by name as linear light, the dark frame subtracted.

    Without a dark frame, no light counts as 0.
    """
    some = next(iter(photos.values()))
    dark = linear(photos["dark"], gamma) if "dark" in photos else np.zeros(some.shape)
    alone = {}
    for name, photo in photos.items():
        number = re.fullmatch(r"fiber-(\d+)", name)
        if number:
            alone[int(number[1])] = linear(photo, gamma) - dark
    return PhotoSet(alone, linear(photos["all"], gamma) - dark if "all" in photos else None)


def load_photo_set(folder: Path, rows: int, columns: int, gamma: float = 1.0) -> PhotoSet:
    """Return the sweep in a folder.

    Arguments:
        folder: with the files named above.
        rows: of every photograph.
        columns: of every photograph.
        gamma: of the photographs, undone here.

    Raises:
        CaptureError: unreadable, wrong size, over-exposed, no sweep at all.
    """
    if not folder.is_dir():
        raise CaptureError(
            f"{folder} is not a folder: give the one that `tactilux hw capture` wrote",
            field="capture",
            value=str(folder),
        )
    found = {path.stem: path for path in sorted(folder.iterdir()) if path.suffix in SUFFIXES}

    def photo(path: Path) -> Array:
        counts = read_photo(path)
        check_photo(counts, rows, columns, str(path))
        return counts

    photos = {name: photo(path) for name, path in found.items()}
    if "dark" in photos:
        check_dark(photos["dark"], str(folder / "dark"))
    if not photos or not (loaded := photo_set(photos, gamma)).alone:
        raise CaptureError(
            f"{folder} holds no sweep: name its photographs fiber-00.png, fiber-01.png, ... or "
            "make them with `tactilux hw capture`",
            field="capture",
            value=str(folder),
        )
    return loaded


def save_photos(photos: dict[str, Array], out: Path) -> None:
    """Write photographs, counts ``(row, column, 3)``, as 16-bit ``.npy`` files into a new folder.

    Raises:
        OutputError: the folder holds something else.
    """
    from optimize.ui.output import OutputError, fresh_directory, write_manifest

    try:
        with fresh_directory(out) as folder:
            for name, photo in photos.items():
                np.save(folder / f"{name}.npy", np.rint(photo * (65535 / 255)).astype(np.uint16))
            write_manifest(folder, {"photographs": len(photos)})
    except OSError as error:
        raise OutputError(
            f"{out} cannot be written ({error.strerror}): choose another place",
            field="out",
            value=str(out),
        ) from None


def check_dark(dark: Array, name: str) -> None:
    """Refuse a dark frame ``(row, column, 3)`` with light in it.

    Raises:
        CaptureError: room light, or an LED that stays on.
    """
    level = float(dark.mean())
    if level > MAX_DARK_COUNTS:
        raise CaptureError(
            f"{name} has {level:.1f} counts with all LEDs off, allowed: at most "
            f"{MAX_DARK_COUNTS:g}; keep room light away, or lower the exposure",
            field="dark",
            value=level,
            allowed=f"at most {MAX_DARK_COUNTS:g}",
        )
