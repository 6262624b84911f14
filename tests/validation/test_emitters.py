"""Every emitter lights a room, glass and fog as Mitsuba's own ``volpath`` finds it."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from tests.validation.film import LONG, check_same, ours, theirs
from tests.validation.lamps import KINDS, lamp, open_room
from tests.validation.rooms import ball, glass, milk

SPP, THEIR_SPP = (16384, 8192) if LONG else (1024, 512)


@pytest.mark.parametrize("emitter", KINDS)
def test_an_emitter_lights_rough_glass_and_fog_as_mitsuba_finds_it(
    mono: ModuleType, emitter: str, tmp_path: Path
) -> None:
    scene = open_room(
        mono, lamp=lamp(mono, emitter, tmp_path), glass=ball(0.7, glass(0.2)),
        fog=ball(-0.9, {"type": "null"}, milk(mono, 1.0)),
    )  # fmt: skip
    truth = theirs(mono, scene, "volpath", THEIR_SPP)
    check_same(ours(mono, scene, "bdpt", SPP), truth, f"{emitter}, rough")
    if LONG:
        check_same(ours(mono, scene, "pssmlt", SPP), truth, f"{emitter}, rough, pssmlt")


@pytest.mark.parametrize("emitter", ["constant", "envmap"])
def test_light_from_afar_passes_smooth_glass_and_milk_as_mitsuba_finds_it(
    mono: ModuleType, emitter: str, tmp_path: Path
) -> None:
    scene = open_room(
        mono, lamp=lamp(mono, emitter, tmp_path), glass=ball(0.7, glass(0.0)),
        milk=ball(-0.9, glass(0.0), milk(mono, 1.0)),
    )  # fmt: skip
    truth = theirs(mono, scene, "volpath", THEIR_SPP)
    check_same(ours(mono, scene, "bdpt", SPP), truth, f"{emitter}, smooth")


def test_lamps_near_and_far_add_up_as_mitsuba_finds_it(mono: ModuleType, tmp_path: Path) -> None:
    lamps = {f"lamp{i}": lamp(mono, k, tmp_path) for i, k in enumerate(KINDS) if k != "envmap"}
    scene = open_room(mono, glass=ball(0.0, glass(0.2)), **lamps)
    truth = theirs(mono, scene, "path", THEIR_SPP)
    check_same(ours(mono, scene, "bdpt", SPP), truth, "five lamps")
