"""The photographs of a sweep as linear counts: dark, every fiber alone, all together.

They come from a camera (`take_sweep`) or from files (`hw.camera.photo_reader`).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hw.camera.full_scale import FULL_SCALE, check_saturation
from hw.camera.opencv_camera import CameraDevice
from hw.errors import CaptureError
from hw.leds.fiber_lights import FiberLights, one_by_one
from render.arrays import Array
from render.progress import Clock, OnProgress
from render.scene import RGB, Palette

DARK_FRAMES = 32
"""Photographs that are averaged for a dark frame: its noise is in everything else."""
MAX_DARK_COUNTS = 20.0
"""Counts that a dark frame may have on average: more is room light or an LED that stays on."""


def check_photo(counts: Array, rows: int, columns: int, name: str) -> None:
    """Refuse a photograph of another size, or one that is over-exposed.

    Raises:
        CaptureError: says which, and what to do.
    """
    if counts.shape[:2] != (rows, columns):
        found_rows, found_columns = counts.shape[:2]
        step = "dewarp it with --lens, or scale it (another camera in the scene is another sensor, "
        step += "which needs its own model)"
        if (found_columns, found_rows) == (rows, columns):
            step = "it lies on its side: turn it by 90 deg, row 0 towards the tip"
        raise CaptureError(
            f"{name} has {found_columns} x {found_rows} pixels, allowed: {columns} x {rows} as the "
            f"scene's camera; {step}",
            field="capture",
        )
    check_saturation(counts, name)


def linear(counts: Array, gamma: float) -> Array:
    """Return counts proportional to light from counts with ``gamma`` (1: as they are)."""
    return counts if gamma == 1.0 else FULL_SCALE * (np.maximum(counts, 0.0) / FULL_SCALE) ** gamma


@dataclass(frozen=True, eq=False)
class PhotoSet:
    """Linear counts ``(row, column, channel)`` each, the dark frame already subtracted.

    ``alone`` is by number of the fiber, ``together`` None when it was not taken. ``compression``
    ``(channel,)`` is the standard deviation, in counts, that averages keep of what files lost.
    """

    alone: dict[int, Array]
    together: Array | None
    compression: Array = field(default_factory=lambda: np.zeros(1))

    def noise(self, pixel: float, pixels: Array) -> Array:
        """Return the standard deviation ``(n, channel)`` of means over ``pixels`` ``(n,)``.

        That of one ``pixel``, in counts, averages out; what compression lost does not.
        """
        return np.hypot((pixel / np.sqrt(pixels))[:, None], self.compression)

    def stacked(self, lit: NDArray[np.bool_], of: Callable[[Array], Array]) -> Array:
        """Return ``of`` the photograph of every fiber, ``(fiber, ...)``.

        It is 0 of those that are not ``lit`` ``(fiber,)`` by the design: sweeps leave them out.

        Raises:
            CaptureError: the photograph of some fiber that is lit is missing.
        """
        missing = [fiber for fiber in np.flatnonzero(lit).tolist() if fiber not in self.alone]
        if missing:
            raise CaptureError(
                f"the sweep has no photograph of fiber {missing[0]} ({len(missing)} "
                f"{'is' if len(missing) == 1 else 'are'} missing), allowed: all of 0 to "
                f"{len(lit) - 1}{'' if lit.all() else ' that the design lights'}; capture the "
                "sweep again",
                field="capture",
            )
        seen = {fiber: of(self.alone[fiber]) for fiber in np.flatnonzero(lit).tolist()}
        dark = np.zeros_like(next(iter(seen.values())))
        return np.stack([seen.get(fiber, dark) for fiber in range(len(lit))])


def take_shots(
    camera: CameraDevice, lights: FiberLights, shots: Array, frames: int = 1, settle: float = 0.0
) -> Array:
    """Return one picture ``(row, column, shot's channel)``: each shot under lights of its own.

    ``shots`` ``(shot, fiber, LED)`` are the powers in [0, 1]. Lights are set, ``settle`` seconds
    pass, and ``frames`` photographs are taken and averaged; then comes the next shot.
    """
    taken = []
    for power in shots:
        lights.set(power)
        lights.hold(settle)
        taken.append(camera.capture(frames))
    return np.concatenate(taken, axis=-1)


def take_sweep(
    camera: CameraDevice,
    lights: FiberLights,
    power: Array,
    palette: Palette = RGB,
    *,
    frames: int = 1,
    settle: float = 0.1,
    together: bool = True,
    prepare: Callable[[Array], Array] = np.asarray,
    progress: OnProgress | None = None,
) -> dict[str, Array]:
    """Return photographs by name as a folder would hold them.

    Each is counts ``(row, column, channel)``. Fibers without ``power`` ``(fiber, color)`` in [0, 1]
    are left out; ``together`` also photographs all at once. ``palette`` says in which shots colors
    shine, see `take_shots`. ``prepare``, a dewarp for example, comes first.
    """
    lights.off()
    lights.hold(settle)
    total = int((power.max(axis=1) > 0).sum()) + 1 + together

    def taken(drive: Array) -> Array:
        return prepare(take_shots(camera, lights, palette.in_shots(drive), frames, settle))

    dark = camera.capture(DARK_FRAMES)
    photos = {"dark": prepare(np.concatenate([dark] * palette.shots, axis=-1))}
    check_dark(photos["dark"], "the dark frame")
    if together:
        photos["all"] = taken(power)
    clock = Clock(total, progress)
    clock.skip(len(photos))
    for fiber, alone in one_by_one(power):
        photos[f"fiber-{fiber:02d}"] = taken(alone)
        clock.tick()
    lights.off()
    return photos


def photo_set(
    photos: dict[str, Array], gamma: float = 1.0, compression: Array | None = None
) -> PhotoSet:
    """Return photographs by name as linear light, the dark frame subtracted.

    Without a dark frame, no light counts as 0. ``compression`` is that of a `PhotoSet`.
    """
    some = next(iter(photos.values()))
    dark = linear(photos["dark"], gamma) if "dark" in photos else np.zeros(some.shape)
    alone = {}
    for name, photo in photos.items():
        number = re.fullmatch(r"fiber-(\d+)", name)
        if number:
            alone[int(number[1])] = linear(photo, gamma) - dark
    together = linear(photos["all"], gamma) - dark if "all" in photos else None
    return PhotoSet(alone, together, np.zeros(1) if compression is None else compression)


SAVED_SCALE = 65535
"""Full scale of photographs that this program wrote."""


def save_photos(photos: dict[str, Array], out: Path, *, dewarped: bool = False) -> None:
    """Write photographs as 16-bit ``.npy`` files into a new folder.

    They are counts ``(row, column, channel)``; a lens was undone where they are ``dewarped``.

    Raises:
        OutputError: the folder holds something else.
    """
    from optimize.ui.output import fresh_directory, writable, write_manifest

    with writable(out), fresh_directory(out) as folder:
        for name, photo in photos.items():
            levels = np.rint(photo * (SAVED_SCALE / FULL_SCALE)).astype(np.uint16)
            np.save(folder / f"{name}.npy", levels)
        write_manifest(folder, {"photographs": len(photos), "dewarped": dewarped})


def check_dark(dark: Array, name: str) -> None:
    """Refuse a dark frame ``(row, column, channel)`` with light in it.

    Raises:
        CaptureError: room light, or an LED that stays on.
    """
    level = float(dark.mean())
    if level > MAX_DARK_COUNTS:
        raise CaptureError(
            f"{name} has {level:.1f} counts with all LEDs off, allowed: at most "
            f"{MAX_DARK_COUNTS:g}; keep room light away, or lower the exposure",
            field="dark",
        )
