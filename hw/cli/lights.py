"""``tactilux hw ports | set | sweep | off``: the LEDs alone."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from hw.cli.wiring import Wiring
from hw.leds.board import dark
from hw.leds.fiber_lights import interruptible, sweep
from hw.leds.ports import ProtocolName, list_serial_ports, open_board, the_port
from optimize.design.design import Design, color_name
from optimize.design.design_file import load_saved
from optimize.ui.console import Meter, note, print_json, reserved_stdout

UNTOLD_LEDS = 64
"""How many LEDs are switched off on a board that cannot say how many it has."""


def ports(*, as_json: bool) -> None:
    """Print the serial ports."""
    with reserved_stdout() as stream:
        found = list_serial_ports()
        if as_json:
            print_json(stream, {"ports": [asdict(info) for info in found]})
            return
        for info in found:
            stream.write(f"{info.port}  {info.description}  {info.serial_number}".rstrip() + "\n")
        if not found:
            note("No serial port of a USB device: plug the LED board in and ask again.")


def set_lights(path: Path, wiring: Wiring, *, seconds: float | None) -> None:
    """Light the design in ``path`` for ``seconds``."""
    with reserved_stdout() as stream, interruptible():
        design = load_saved(path).design
        with wiring.lights(len(design.phi)) as lights:
            power = design.power * wiring.scale
            lights.set(power)
            ends = "until Ctrl-C" if seconds is None else f"for {seconds:g} s"
            note(
                f"{lights.board.name}: {_lit(design)} of {len(design.phi)} fibers lit, "
                f"{lights.limits.current(power):.0f} mA, {ends}"
            )
            lights.hold(seconds)
        stream.write("All LEDs are off.\n")


def sweep_lights(path: Path, wiring: Wiring, *, seconds: float) -> None:
    """Light one fiber of the design in ``path`` after the other."""
    with reserved_stdout() as stream, interruptible():
        design = load_saved(path).design
        with wiring.lights(len(design.phi)) as lights, Meter("Sweeping") as meter:
            names = [color_name(index) for index in design.colors]
            for done, fiber in enumerate(sweep(lights, design.power * wiring.scale, seconds)):
                led = lights.channels.leds[fiber]
                stream.write(f"fiber {fiber}, LED {led}: {names[fiber]}\n")
                stream.flush()
                meter(done + 1, _lit(design))
        stream.write("All LEDs are off.\n")


def off(port: str | None, protocol: str, baud: int, *, count: int | None) -> None:
    """Switch every LED of the board off."""
    speech = ProtocolName(protocol)
    with reserved_stdout() as stream:
        told = speech is not ProtocolName.ADALIGHT
        leds = count or (1 if told else UNTOLD_LEDS)
        board = open_board(the_port(port), speech, leds=leds, baud=baud)
        try:
            board.show(dark(board.leds))
        finally:
            board.close()
        stream.write(f"{board.name}: all {board.leds} LEDs are off.\n")


def _lit(design: Design) -> int:
    return int((design.power.max(axis=1) > 0).sum())
