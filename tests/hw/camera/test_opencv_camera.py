"""A camera that cannot be locked is refused; frames arrive as red, green, blue."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hw.camera.opencv_camera import STALE_FRAMES, LockedSettings, OpenCVCamera
from hw.errors import CameraError

cv2 = pytest.importorskip("cv2")


@pytest.fixture
def recording(tmp_path: Path) -> str:
    """Write a short recording: OpenCV reads it as it reads a camera."""
    path = str(tmp_path / "recording.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    frame = np.zeros((48, 64, 3), dtype=np.uint8)
    frame[..., 2] = 200
    for _ in range(8):
        writer.write(frame)
    writer.release()
    return path


def test_a_missing_camera_raises_one_clear_error() -> None:
    with pytest.raises(CameraError, match="plug it in"):
        OpenCVCamera(97)


def test_a_camera_that_keeps_its_automatics_is_refused(recording: str) -> None:
    with pytest.raises(CameraError, match="automatic exposure"):
        OpenCVCamera(recording, LockedSettings())


def test_red_is_the_first_channel(recording: str) -> None:
    camera = OpenCVCamera(recording, unchecked=True)
    photo = camera.capture(2)
    camera.close()
    assert photo.shape == (48, 64, 3)
    assert photo[..., 0].mean() > 150
    assert photo[..., 1:].max() < 60


def test_a_camera_that_stops_raises_one_clear_error(recording: str) -> None:
    camera = OpenCVCamera(recording, unchecked=True)
    with pytest.raises(CameraError, match="no more frames"):
        camera.capture(50)
    camera.close()


def without_frames(recording: str, first: int, count: int) -> None:
    """Make frames of a recording unreadable, as a camera that drops them."""
    content = bytearray(Path(recording).read_bytes())
    place = -1
    for number in range(first + count):
        place = content.index(b"00dc", place + 1)
        size = int.from_bytes(content[place + 4 : place + 8], "little")
        if number >= first:
            content[place + 8 : place + 8 + size] = bytes(size)
    Path(recording).write_bytes(content)


def test_a_few_dropped_frames_are_left_out_of_the_mean(recording: str) -> None:
    without_frames(recording, STALE_FRAMES + 1, 2)
    camera = OpenCVCamera(recording, unchecked=True)
    photo = camera.capture(2)
    camera.close()
    # A dropped frame that counted would halve the light.
    assert photo[..., 0].mean() == pytest.approx(200.0, abs=5.0)


def test_too_many_dropped_frames_raises_one_clear_error(recording: str) -> None:
    without_frames(recording, STALE_FRAMES + 1, 3)
    camera = OpenCVCamera(recording, unchecked=True)
    with pytest.raises(CameraError, match="no more frames"):
        camera.capture(2)
    camera.close()


def test_a_gray_scenes_camera_must_be_gray(recording: str, tmp_path: Path) -> None:
    color = OpenCVCamera(recording, channels=1, unchecked=True)
    with pytest.raises(CameraError, match=r"sees colors, by 1\d\d counts, allowed: gray"):
        color.capture()
    color.close()
    path = str(tmp_path / "gray.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for _ in range(8):
        writer.write(np.full((48, 64, 3), 90, dtype=np.uint8))
    writer.release()
    gray = OpenCVCamera(path, channels=1, unchecked=True)
    photo = gray.capture(2)
    gray.close()
    assert photo.shape == (48, 64, 1)
    assert photo.mean() == pytest.approx(90.0, abs=3.0)


def test_a_live_camera_of_four_channels_raises_one_clear_error(recording: str) -> None:
    with pytest.raises(CameraError, match=r"4 channels, allowed for a live one: 1 or 3"):
        OpenCVCamera(recording, channels=4, unchecked=True)
