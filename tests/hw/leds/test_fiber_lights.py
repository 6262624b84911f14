"""Lights go off whatever happens, and come back after a lost link."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hw.emulator.emulated_board import EmulatedBoard
from hw.errors import LinkError
from hw.leds import ProtocolName
from hw.leds.board import dark
from hw.leds.channels import ChannelMap
from hw.leds.fiber_lights import FiberLights, sweep
from hw.leds.ports import open_board
from tests.hw.conftest import Plug

ROOT = Path(__file__).parents[3]
POWER = np.eye(3)[np.arange(20) % 3]
SHOWN = (255 * POWER).astype(np.uint8)


def lights_on(rig: EmulatedBoard, patience: float = 3.0) -> FiberLights:
    connect = partial(open_board, str(rig.port), ProtocolName.LINES, leds=20, timeout=0.1)
    return FiberLights(connect, ChannelMap.straight(20), patience=patience)


def test_all_leds_are_off_at_the_end(plug: Plug) -> None:
    rig = plug()
    with lights_on(rig) as lights:
        lights.set(POWER)
        assert rig.wait_for(SHOWN)
    assert not rig.levels.any()


def test_all_leds_are_off_after_a_mistake_of_the_program(plug: Plug) -> None:
    rig = plug()

    def fail() -> None:
        with lights_on(rig) as lights:
            lights.set(POWER)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert not rig.levels.any()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_all_leds_are_off_when_the_program_is_told_to_end(
    plug: Plug, tmp_path: Path, number: int
) -> None:
    rig = plug()
    code = (
        "import signal, sys, numpy as np\n"
        "from functools import partial\n"
        "from hw.leds import ProtocolName\n"
        "from hw.leds.ports import open_board\n"
        "from hw.leds.channels import ChannelMap\n"
        "from hw.leds.fiber_lights import FiberLights\n"
        "from optimize.ui.process import run_process\n"
        # Started in the background, tests would hand on that these are ignored.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
        "connect = partial(open_board, sys.argv[1], ProtocolName.LINES, leds=20)\n"
        "def main():\n"
        "    with FiberLights(connect, ChannelMap.straight(20)) as lights:\n"
        "        lights.set(np.eye(3)[np.arange(20) % 3])\n"
        "        lights.hold(None)\n"
        "run_process(lambda: main)\n"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", code, str(rig.port)], cwd=ROOT, stderr=subprocess.DEVNULL
    )
    try:
        assert rig.wait_for(SHOWN, 20.0)
        os.kill(child.pid, number)
        child.wait(10.0)
    finally:
        child.kill()
    assert not rig.levels.any()


def test_a_killed_program_leaves_the_board_to_its_watchdog(plug: Plug) -> None:
    rig = plug()
    lights = lights_on(rig)
    lights.set(POWER)
    assert rig.wait_for(SHOWN)
    lights.board.close()
    assert rig.wait_for(dark(20), 4.0)


def test_holding_light_feeds_the_watchdog(plug: Plug) -> None:
    rig = plug()
    with lights_on(rig) as lights:
        lights.board._request("WDT 300")  # type: ignore[attr-defined]
        lights.board.dark_after = 0.3
        lights.set(POWER)
        lights.hold(1.0)
        assert np.array_equal(rig.levels, SHOWN)


def test_a_board_that_comes_back_shows_the_light_again(plug: Plug) -> None:
    rig = plug()
    with lights_on(rig) as lights:
        lights.set(POWER)
        rig.unplug()
        timer = threading.Timer(0.3, rig.plug_in)
        timer.start()
        lights.set(POWER)
        assert rig.wait_for(SHOWN)
        timer.join()


def test_a_board_that_stays_away_raises_and_says_what_its_leds_do(plug: Plug) -> None:
    rig = plug()
    began = time.monotonic()

    def lose() -> None:
        with lights_on(rig, 0.3) as lights:
            lights.set(POWER)
            rig.unplug()
            lights.set(POWER)

    with pytest.raises(LinkError, match="go dark by themselves within 2 s"):
        lose()
    assert time.monotonic() - began < 5.0


def test_a_sweep_lights_one_fiber_at_a_time_and_skips_dark_ones(plug: Plug) -> None:
    rig = plug()
    power = POWER.copy()
    power[3] = 0.0
    seen = []
    with lights_on(rig) as lights:
        for fiber in sweep(lights, power):
            assert rig.levels.any(axis=1).sum() == 1
            assert (rig.levels[fiber] == SHOWN[fiber]).all()
            seen.append(fiber)
        assert not rig.levels.any()
    assert seen == [fiber for fiber in range(20) if fiber != 3]
