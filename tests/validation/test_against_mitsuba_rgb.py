"""Colored light in colored media, in Mitsuba's rgb variant (a process of its own).

Mitsuba's variant can be changed only before its types are used, so no other test shares this file.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.validation.film import LONG, camera, check_same, ours, theirs
from tests.validation.lamps import KINDS, lamp, open_room
from tests.validation.rooms import ball, glass, milk, room

SPP, THEIR_SPP = (32768, 4096) if LONG else (512, 64)


@pytest.fixture(scope="module")
def rgb() -> ModuleType:
    from render.reference import mitsuba

    return mitsuba("llvm_ad_rgb")


@pytest.mark.parametrize("kind", ["bdpt", "pssmlt"] if LONG else ["pssmlt"])
def test_the_cornell_box_has_the_colors_that_mitsuba_finds(rgb: ModuleType, kind: str) -> None:
    scene = rgb.load_dict(
        rgb.cornell_box() | {"sensor": camera(rgb, [0, 0, 3.9], fov=30, target=(0, -0.3, 0))}
    )
    check_same(
        ours(rgb, scene, kind, SPP), theirs(rgb, scene, "path", THEIR_SPP), f"cornell box, {kind}"
    )


@pytest.mark.parametrize("kind", ["bdpt", "pssmlt"] if LONG else ["bdpt"])
def test_colored_media_have_the_colors_that_mitsuba_finds(rgb: ModuleType, kind: str) -> None:
    scene = room(
        rgb, point=True, milk=ball(0.8, glass(0.3), milk(rgb)),
        fog=ball(-0.8, {"type": "null"}, milk(rgb, 1.0, -0.4)),
    )  # fmt: skip
    truth = theirs(rgb, scene, "volpath", THEIR_SPP)
    check_same(ours(rgb, scene, kind, SPP), truth, f"colored media, {kind}")


@pytest.mark.parametrize("emitter", KINDS if LONG else ["directional", "envmap"])
def test_an_emitter_has_the_colors_that_mitsuba_finds(
    rgb: ModuleType, emitter: str, tmp_path: Path
) -> None:
    scene = open_room(
        rgb, lamp=lamp(rgb, emitter, tmp_path), glass=ball(0.7, glass(0.2)),
        fog=ball(-0.9, {"type": "null"}, milk(rgb, 1.0)),
    )  # fmt: skip
    truth = theirs(rgb, scene, "volpath", 8 * THEIR_SPP)
    check_same(ours(rgb, scene, "bdpt", 2 * SPP), truth, f"{emitter}, rgb")


def test_one_path_colors_every_channel_of_gray_light_alike(rgb: ModuleType) -> None:
    towards = rgb.ScalarTransform4f().rotate([0, 1, 0], 180)
    scene = rgb.load_dict(
        {
            "type": "scene",
            "sensor": camera(rgb, [0, 0, -3]),
            "plane": {"type": "rectangle", "to_world": towards},
            "lamp": {"type": "point", "position": [0, 0, -2]},
        }
    )  # fmt: skip
    image = ours(rgb, scene, "bdpt", 64)
    np.testing.assert_allclose(image[..., 1], image[..., 0], rtol=1e-5)
    np.testing.assert_allclose(image[..., 2], image[..., 0], rtol=1e-5)
