"""Photographs as linear counts, and those of a sweep: dark, every fiber alone, all together.

Those that cannot be used are refused. A folder of a sweep holds ``dark``, ``all`` and ``fiber-00``,
``fiber-01``, ... as PNG, JPEG or ``.npy``; ``hw/README.md`` describes it. Photographs have as many
channels as the scene's camera: pictures one or three, arrays any number.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hw.camera.opencv_camera import MAX_TINT_COUNTS, CameraDevice, tint_counts
from hw.errors import CaptureError
from hw.leds.fiber_lights import FiberLights, sweep
from render.arrays import Array
from render.files import read_bytes
from render.progress import Clock, OnProgress

FULL_SCALE = 255.0
SATURATED_COUNTS = 250.0
"""Counts from which a pixel is called over-exposed: demosaicing blurs the very top."""
MAX_OVEREXPOSED_FRACTION = 0.002
"""Part of over-exposed pixels from which a photograph is refused."""
DARK_FRAMES = 32
"""Photographs that are averaged for a dark frame: its noise is in everything else."""
MAX_DARK_COUNTS = 20.0
"""Counts that a dark frame may have on average: more is room light or an LED that stays on."""
MAX_PIXELS = 64_000_000


def read_photo(path: Path, channels: int = 3) -> Array:
    """Return the photograph as counts ``(row, column, channel)``, 0 to 255.

    PNG, JPEG and TIFF files of one (gray, 8 or 16 bits) or three channels (red, green, blue), and
    ``.npy`` arrays of uint8, uint16 or float counts of any number. The counts are as the camera
    gave them: a gamma is not undone here. An opaque alpha channel is dropped.

    Raises:
        CaptureError: unreadable, not of so many ``channels``, or not finite.
    """
    try:
        content = read_bytes(path)
        pixels = _array(content) if path.suffix == ".npy" else _picture(content, channels)
    except IsADirectoryError:
        raise _unreadable(path, "it is a directory") from None
    except OSError as error:
        raise _unreadable(path, error.strerror or "it is not an image") from None
    except (ValueError, EOFError, SyntaxError, MemoryError) as error:
        raise _unreadable(path, str(error) or "it is not an image") from None
    if pixels.ndim == 2 and channels == 1:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or pixels.shape[2] != channels or 0 in pixels.shape:
        raise CaptureError(
            f"{path} has shape {pixels.shape}, allowed: (rows, columns, {channels}), the channels "
            "of the scene's camera; capture with that camera",
            field="capture",
        )
    scale = {np.dtype(np.uint8): 1.0, np.dtype(np.uint16): FULL_SCALE / 65535}.get(
        pixels.dtype, 1.0
    )
    counts = pixels.astype(np.float64) * scale
    if not np.isfinite(counts).all():
        raise CaptureError(
            f"{path} holds values that are not finite: capture it again", field="capture"
        )
    return counts


def check_photo(counts: Array, rows: int, columns: int, name: str) -> None:
    """Refuse a photograph of another size, or one that is over-exposed.

    Raises:
        CaptureError: says which, and what to do.
    """
    if counts.shape[:2] != (rows, columns):
        found_rows, found_columns = counts.shape[:2]
        raise CaptureError(
            f"{name} has {found_columns} x {found_rows} pixels, allowed: {columns} x {rows} as the "
            "scene's camera; dewarp it with --lens, or scale it (another camera in the scene is "
            "another sensor, which needs its own model)",
            field="capture",
        )
    part = float((counts >= SATURATED_COUNTS).any(axis=2).mean())
    if part > MAX_OVEREXPOSED_FRACTION:
        raise CaptureError(
            f"{name} is over-exposed in {100 * part:.1f} % of its pixels, allowed: at most "
            f"{100 * MAX_OVEREXPOSED_FRACTION:g} %; lower the exposure or the power",
            field="capture",
        )


def linear(counts: Array, gamma: float) -> Array:
    """Return counts proportional to light from counts with ``gamma`` (1: as they are)."""
    return counts if gamma == 1.0 else FULL_SCALE * (np.maximum(counts, 0.0) / FULL_SCALE) ** gamma


def _picture(content: bytes, channels: int) -> NDArray[np.generic]:
    import warnings

    from PIL import Image

    Image.MAX_IMAGE_PIXELS = MAX_PIXELS
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        try:
            with Image.open(io.BytesIO(content)) as image:
                if channels not in (1, 3):
                    raise ValueError(
                        f"the scene's camera has {channels} channels, which .npy files alone have"
                    )
                gray = ("L", "LA", "I;16") if channels == 1 else ()
                if image.mode not in ("RGB", "RGBA", *gray):
                    allowed = "gray" if channels == 1 else "RGB"
                    raise ValueError(f"its mode is {image.mode}, not {allowed}")
                # A cut-out or an overlay: its colors are not those that the camera saw.
                if "A" in image.mode and image.getchannel("A").getextrema() != (255, 255):
                    raise ValueError("it is transparent in places")
                if image.mode in gray:
                    return np.asarray(image if image.mode == "I;16" else image.convert("L"))
                pixels = np.asarray(image.convert("RGB"))
                if channels == 1 and (tint := tint_counts(pixels)) > MAX_TINT_COUNTS:
                    raise ValueError(
                        f"it has colors, channels that differ by {tint:.0f} counts, where the "
                        "scene's camera sees gray"
                    )
                return pixels.mean(axis=-1, keepdims=True) if channels == 1 else pixels
        except (Image.DecompressionBombWarning, Image.DecompressionBombError):
            raise ValueError("it is too large") from None


def _array(content: bytes) -> NDArray[np.generic]:
    found: NDArray[np.generic] = np.load(io.BytesIO(content), allow_pickle=False)
    if found.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
        raise ValueError(f"its type is {found.dtype}, not uint8, uint16 or float")
    return found


def _unreadable(path: Path, reason: str) -> CaptureError:
    return CaptureError(
        f"{path} cannot be read as a photograph ({reason}): give a PNG, JPEG or .npy file",
        field="capture",
    )


SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy")


@dataclass(frozen=True, eq=False)
class PhotoSet:
    """Linear counts ``(row, column, channel)`` each, the dark frame already subtracted.

    ``alone`` is by number of the fiber, ``together`` None when it was not taken.
    """

    alone: dict[int, Array]
    together: Array | None

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
    """Return photographs by name as a folder would hold them.

    Each is counts ``(row, column, channel)``. Fibers without ``power`` ``(fiber, color)`` in [0, 1]
    are left out; ``together`` also photographs all at once. ``frames`` are averaged, ``settle``
    seconds after a light was set; ``prepare``, a dewarp for example, comes first.
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


def load_photo_set(
    folder: Path, rows: int, columns: int, gamma: float = 1.0, channels: int = 3
) -> PhotoSet:
    """Return the sweep in a folder.

    Every photograph has ``rows``, ``columns`` and ``channels``; its ``gamma`` is undone.

    Raises:
        CaptureError: unreadable, wrong size, over-exposed, no sweep at all.
    """
    if not folder.is_dir():
        raise CaptureError(
            f"{folder} is not a folder: give the one that `tactilux hw capture` wrote",
            field="capture",
        )
    found = {path.stem: path for path in sorted(folder.iterdir()) if path.suffix in SUFFIXES}

    def photo(path: Path) -> Array:
        counts = read_photo(path, channels)
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
        )
    return loaded


def save_photos(photos: dict[str, Array], out: Path) -> None:
    """Write photographs as 16-bit ``.npy`` files into a new folder.

    They are counts ``(row, column, channel)``.

    Raises:
        OutputError: the folder holds something else.
    """
    from optimize.ui.output import fresh_directory, writable, write_manifest

    with writable(out), fresh_directory(out) as folder:
        for name, photo in photos.items():
            np.save(folder / f"{name}.npy", np.rint(photo * (65535 / 255)).astype(np.uint16))
        write_manifest(folder, {"photographs": len(photos)})


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
