"""A real camera through OpenCV: exposure, gain and white balance locked, and read back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hw.errors import CameraError
from render.arrays import Array

MAX_MISSING_FRAMES = 5
"""Frames in a row that may be missing before a capture fails."""
STALE_FRAMES = 4
"""Frames that drivers keep in store; they are thrown away before each capture."""

MAX_TINT_COUNTS = 3.0
"""Mean counts by which channels of a gray picture may differ, as JPEG leaves it."""


def tint_counts(pixels: NDArray[np.generic]) -> float:
    """Return by how many counts channels of ``(row, column, channel)`` differ, on average."""
    return float(np.ptp(pixels.astype(np.float64), axis=-1).mean())


class CameraDevice(Protocol):
    """Anything that takes photographs."""

    def capture(self, frames: int = 1) -> Array:
        """Return the mean of ``frames`` photographs, counts ``(row, column, channel)``."""

    def close(self) -> None:
        """Give the camera back."""


@dataclass(frozen=True)
class LockedSettings:
    """What must not change between photographs; exposure in the back end's own unit.

    Of exposure and gain as the driver counts them and white balance in kelvin, None leaves what is.
    """

    exposure: float | None = None
    gain: float | None = None
    white_balance: float | None = None


class OpenCVCamera:
    """A camera that OpenCV knows, everything automatic switched off.

    ``source`` is its number or the path of a recording; ``channels`` are those of the scene's
    camera, 3 (red, green, blue) or 1 (gray); ``unchecked`` accepts a driver that cannot say what it
    has set (recordings, some cameras).
    """

    def __init__(
        self,
        source: int | str,
        locked: LockedSettings | None = None,
        *,
        channels: int = 3,
        unchecked: bool = False,
    ) -> None:
        """Open and lock the camera.

        Raises:
            CameraError: no camera, one that does not keep what it is set to, or a number of
                ``channels`` that none has.
        """
        import cv2

        if channels not in (1, 3):
            raise CameraError(
                f"the scene's camera has {channels} channels, allowed for a live one: 1 or 3; take "
                "the photographs with its maker's program, and give them as .npy files",
                field="camera",
            )
        self.source, self.channels = source, channels
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        self._capture = cv2.VideoCapture(source)
        if not self._capture.isOpened():
            raise CameraError(
                f"camera {source} cannot be opened: plug it in, end other programs that use it, or "
                "choose another --camera",
                field="camera",
            )
        try:
            if not unchecked:
                self._lock(locked or LockedSettings(), cv2)
        except BaseException:
            self.close()
            raise

    def _lock(self, locked: LockedSettings, cv2: Any) -> None:
        # V4L2 takes 1 for manual exposure, other back ends 0 or 0.25.
        self._switch_off("automatic exposure", cv2.CAP_PROP_AUTO_EXPOSURE, (1.0, 0.25, 0.0))
        self._switch_off("automatic white balance", cv2.CAP_PROP_AUTO_WB, (0.0,))
        for name, prop, value in (
            ("exposure", cv2.CAP_PROP_EXPOSURE, locked.exposure),
            ("gain", cv2.CAP_PROP_GAIN, locked.gain),
            ("white balance", cv2.CAP_PROP_WB_TEMPERATURE, locked.white_balance),
        ):
            if value is not None:
                self._set(name, prop, value)

    def _switch_off(self, name: str, prop: int, values: tuple[float, ...]) -> None:
        for value in values:
            if self._capture.set(prop, value) and self._capture.get(prop) == value:
                return
        raise CameraError(
            f"camera {self.source} does not let its {name} be switched off: switch it off with the "
            "maker's program (v4l2-ctl on Linux), or use another camera",
            field=name,
        )

    def _set(self, name: str, prop: int, value: float) -> None:
        accepted = self._capture.set(prop, value)
        found = float(self._capture.get(prop))
        if not accepted or abs(found - value) > 1e-3 * max(abs(value), 1.0):
            raise CameraError(
                f"camera {self.source} has {name} {found:g} after it was set to {value:g}: choose "
                "a value that it can keep",
                field=name,
            )

    def capture(self, frames: int = 1) -> Array:
        """Return the mean of ``frames`` photographs, counts ``(row, column, channel)``.

        Three channels are red, green and blue.

        Raises:
            CameraError: the camera was unplugged, drops frames, or has other channels.
        """
        for _ in range(STALE_FRAMES):
            self._capture.grab()
        total: Array | None = None
        missing = count = 0
        while count < frames:
            good, frame = self._capture.read()
            if not good or frame is None:
                missing += 1
                if missing > MAX_MISSING_FRAMES:
                    raise CameraError(
                        f"camera {self.source} gives no more frames: check its cable, use a free "
                        "USB port, then try again",
                        field="camera",
                    )
                continue
            missing, count = 0, count + 1
            counts = self._counts(frame)
            total = counts if total is None else total + counts
        assert total is not None
        return total / frames

    def _counts(self, frame: NDArray[np.generic]) -> Array:
        """Return a frame in the scene's channels."""
        counts = np.atleast_3d(frame).astype(np.float64)
        if counts.shape[2] not in (1, 3) or counts.shape[2] < self.channels:
            raise CameraError(
                f"camera {self.source} gives frames of shape {frame.shape}, allowed: "
                f"{'color' if self.channels == 3 else 'gray'}; use a camera of the scene's kind",
                field="camera",
            )
        if self.channels == 3:
            # OpenCV's channels are blue, green, red.
            return np.asarray(counts[..., ::-1])
        # Drivers give gray cameras three channels that are alike.
        if (tint := tint_counts(counts)) > MAX_TINT_COUNTS:
            raise CameraError(
                f"camera {self.source} sees colors, by {tint:.0f} counts, allowed: gray; use a "
                "gray camera, or name the channels red, green and blue in the scene's [camera]",
                field="camera",
            )
        return np.asarray(counts.mean(axis=2, keepdims=True))

    def close(self) -> None:
        """Give the camera back."""
        self._capture.release()
