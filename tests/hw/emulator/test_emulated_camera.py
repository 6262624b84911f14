"""The emulated camera has the imperfections that it is given, and no others."""

from __future__ import annotations

from dataclasses import fields
from functools import partial

import numpy as np
import pytest

from hw.camera.photo_set import photo_set, take_sweep
from hw.camera.self_test import self_test
from hw.emulator.emulated_camera import CameraImperfections, EmulatedCamera
from hw.errors import CaptureError
from hw.leds import ProtocolName
from hw.leds.channels import ChannelMap, PowerLimits
from hw.leds.fiber_lights import FiberLights
from hw.leds.ports import open_board
from render.arrays import Array
from render.scene import Scene, load_scene, unchecked
from tests.hw.conftest import Plug


def small_scene() -> Scene:
    scene = load_scene("finger20")
    camera = unchecked(scene.camera, {"rows": 60, "columns": 36})
    return unchecked(scene, {"camera": camera})


SCENE = small_scene()
IMAGES = (
    np.ones((20, 60, 36), dtype=np.float32) * np.linspace(0.5, 1, 60, dtype=np.float32)[:, None]
)


def rig(plug: Plug, imperfections: CameraImperfections) -> tuple[EmulatedCamera, FiberLights]:
    board = plug()
    connect = partial(open_board, str(board.port), ProtocolName.LINES, leds=20)
    lights = FiberLights(connect, ChannelMap.straight(20), PowerLimits(total_milliamperes=2000))
    return EmulatedCamera(SCENE, IMAGES, board, 10.0, np.ones(20), imperfections), lights


def test_it_sees_the_light_that_the_board_shows(plug: Plug) -> None:
    camera, lights = rig(plug, CameraImperfections(noise=0.0))
    with lights:
        power = np.zeros((20, 3))
        power[3, 0], power[7, 2] = 1.0, 1.0
        lights.set(power)
        photo = camera.capture()
    np.testing.assert_allclose(photo[30, 18], [16.0, 8.0, 16.0], atol=1.0)


def test_each_channel_sees_its_own_image_of_a_colored_skin(plug: Plug) -> None:
    camera, lights = rig(plug, CameraImperfections(noise=0.0))
    tints = np.array([1.0, 0.5, 0.25], dtype=np.float32)
    colored = EmulatedCamera(
        SCENE, IMAGES[..., None] * tints, camera.board, 10.0, np.ones(20), camera.imperfections
    )
    with lights:
        lights.set(np.full((20, 3), 0.5))
        plain, seen = camera.capture(), colored.capture()
    np.testing.assert_allclose(seen - 8.0, (plain - 8.0) * tints, atol=1.0)


def test_a_sweep_has_every_fiber_and_their_sum(plug: Plug) -> None:
    camera, lights = rig(plug, CameraImperfections(noise=0.0))
    with lights:
        photos = photo_set(take_sweep(camera, lights, np.full((20, 3), 0.5), settle=0.0))
    assert photos.together is not None
    total = sum(photos.alone.values())
    np.testing.assert_allclose(total, photos.together, atol=12.0)


class SwappedCamera(EmulatedCamera):
    """A camera whose photographs arrive as blue, green, red."""

    def capture(self, frames: int = 1) -> Array:
        return super().capture(frames)[..., ::-1]


def test_the_self_test_notices_swapped_channels(plug: Plug) -> None:
    camera, lights = rig(plug, CameraImperfections())
    swapped = SwappedCamera(**{field.name: getattr(camera, field.name) for field in fields(camera)})
    with lights, pytest.raises(CaptureError, match="--order to bgr"):
        self_test(swapped, lights, 0.3, 0.0)


def test_the_self_test_notices_room_light(plug: Plug) -> None:
    camera, lights = rig(plug, CameraImperfections(black=48.0))
    with lights, pytest.raises(CaptureError, match="room light"):
        self_test(camera, lights, 0.3, 0.0)


def test_the_self_test_passes_a_good_rig(plug: Plug) -> None:
    camera, lights = rig(plug, CameraImperfections())
    with lights:
        dark = self_test(camera, lights, 0.3, 0.0)
    assert dark.mean() == pytest.approx(8.0, abs=0.2)
