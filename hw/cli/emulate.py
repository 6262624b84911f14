"""``tactilux hw emulate``: an LED board without hardware, for other commands to talk to."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import Option

from hw.cli.options import SceneOption, SpokenProtocol
from hw.leds import ProtocolName
from optimize.ui.console import counted, note, reserved_stdout

if TYPE_CHECKING:
    from hw.leds.board import Levels

LOOK_SECONDS = 0.05
"""Seconds between two looks at the LEDs."""
RGB_NAMES = ("red", "green", "blue")
COLOR_NAMES = {"FF0000": "red", "00FF00": "green", "0000FF": "blue", "FFFFFF": "white"}


def run(
    port: Annotated[Path, Option(help="Where the board's serial port is to appear: a new name.")],
    protocol: SpokenProtocol = ProtocolName.LINES,
    leds: Annotated[
        int | None,
        Option(min=1, max=512, help="LEDs that the board drives (default: as the scene needs)."),
    ] = None,
    scene_name: SceneOption = "finger20",
    state: Annotated[
        str, Option(help="What is wrong with the board, as limiter or live (default: nothing).")
    ] = "",
) -> None:
    """Be an LED board for other commands, until Ctrl-C."""
    from hw.emulator.emulated_board import EmulatedBoard, states_of
    from hw.errors import PortError
    from optimize.mounting import leds_per_fiber
    from render.scene import load_scene

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        names = scene.palette.one_shot.names
        leds = leds or scene.lamp_count * leds_per_fiber(len(names))
        states = states_of(protocol)
        if state and state not in states:
            raise PortError(
                f"--state {state} is none of a {protocol} board, allowed: "
                f"{', '.join(states) or 'none'}; correct --state",
                field="state",
            )
        if port.is_symlink() or port.exists():
            raise PortError(
                f"{port} is there already: give --port a name that is free, or remove it",
                field="port",
            )
        try:
            board = EmulatedBoard(port, protocol, leds, state)
        except OSError as error:
            raise PortError(
                f"{port} cannot be made ({error.strerror}): give --port another place", field="port"
            ) from None
        with board:
            spoken = "" if protocol is ProtocolName.LINES else f" --protocol {protocol}"
            note(
                f"A board with {counted(leds, 'LED')} is on {port} until Ctrl-C. In another shell: "
                f"tactilux hw set design.json --port {port}{spoken}"
            )
            _watch(board.port, stream, lambda: shown(board.levels, names))


def _watch(port: Path, stream: IO[str], look: Callable[[], str]) -> None:
    """Write what the LEDs show whenever that changes."""
    said = None
    while port.is_symlink():
        told = look()
        if told != said:
            stream.write(told + "\n")
            stream.flush()
            said = told
        time.sleep(LOOK_SECONDS)


def shown(levels: Levels, names: tuple[str, ...] = RGB_NAMES) -> str:
    """Return which LEDs are lit, with their colors, which have ``names`` in the scene.

    >>> import numpy as np
    >>> levels = np.array([[255, 0, 0], [0, 0, 0], [0, 128, 7]], dtype=np.uint8)
    >>> shown(levels)
    '2 of 3 LEDs lit: 0 red, 2 #008007'
    >>> shown(levels[:2], ("white", "infrared"))
    '1 of 2 LEDs lit: 0 white'
    """
    lit = {led: color for led, color in enumerate(levels) if color.any()}
    if not lit:
        return "All LEDs are dark."
    named = (f"{led} {_color(led, color, names)}" for led, color in lit.items())
    return f"{len(lit)} of {len(levels)} LEDs lit: {', '.join(named)}"


def _color(led: int, levels: Levels, names: tuple[str, ...]) -> str:
    """Return what an LED shows, ``levels`` ``(3,)`` of its channels.

    >>> import numpy as np
    >>> _color(1, np.array([0, 255, 128], dtype=np.uint8), ("a", "b", "c", "d", "white", "amber"))
    'white + amber at 50 %'
    """
    from optimize.mounting import leds_per_fiber

    code = bytes(levels).hex().upper()
    if names == RGB_NAMES:
        return COLOR_NAMES.get(code, f"#{code}")
    # A fiber of more colors than an LED has channels takes several LEDs, see `Feeds`.
    first = 3 * (led % leds_per_fiber(len(names)))
    own = dict(zip(names[first : first + 3], levels.tolist(), strict=False))
    if levels[len(own) :].any():
        return f"#{code}"
    return " + ".join(
        name if level == 255 else f"{name} at {100 * level / 255:.0f} %"
        for name, level in own.items()
        if level
    )
