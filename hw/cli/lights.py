"""``tactilux hw ports | set | sweep | off``: the LEDs alone."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from hw.cli.options import Baud, Calibrated, Port, SpokenProtocol, Wiring, grouped
from hw.leds import ProtocolName
from optimize.cli.options import DesignArgument, Json
from optimize.ui.console import ProgressBar, note, print_json, reserved_stdout
from render.progress import Progress

if TYPE_CHECKING:
    from optimize.design.design_file import DesignFile
    from render.arrays import Array
    from render.scene import Palette

Fiber = Annotated[int | None, Option(min=0, help="Light this fiber alone (default: all).")]
UNTOLD_LEDS = 64
"""How many LEDs are switched off on a board that cannot say how many it has."""


def ports(as_json: Json = False) -> None:
    """List the serial ports that LED boards may be on."""
    from hw.leds.ports import list_serial_ports

    with reserved_stdout() as stream:
        found = list_serial_ports()
        if as_json:
            print_json(stream, {"ports": [asdict(info) for info in found]})
            return
        for info in found:
            stream.write(f"{info.port}  {info.description}  {info.serial_number}".rstrip() + "\n")
        if not found:
            note("No serial port of a USB device: plug the LED board in and ask again.")


@grouped
def set_lights(
    path: DesignArgument,
    *,
    wiring: Wiring,
    fiber: Fiber = None,
    calibration: Calibrated = None,
    shot: Annotated[int, Option(help="Which shot of a design of several to show.")] = 1,
    seconds: Annotated[
        float | None, Option(min=0.0, help="How long (default: until Ctrl-C).")
    ] = None,
) -> None:
    """Light the fibers as a design says; off when the command ends."""
    from optimize.design import load_design_file

    with reserved_stdout() as stream:
        file = load_design_file(path)
        design, drive = file.design, _drive(file, path, calibration)
        power = only(fiber, in_shot(shot, design.palette, drive * wiring.scale))
        with wiring.lights(*power.shape) as lights:
            lights.set(power)
            ends = "until Ctrl-C" if seconds is None else f"for {seconds:g} s"
            lit, unread = ("lit", "") if not lights.board.unread else (
                "told to light", f"; not read back: {lights.board.unread}"
            )  # fmt: skip
            note(
                f"{lights.board.name}: {lights.lit} of {len(design.phi)} fibers {lit}, "
                f"{lights.limits.current(power):.0f} mA, {ends}{unread}"
            )
            lights.hold(seconds)
        stream.write("All LEDs are off.\n")


@grouped
def sweep_lights(
    path: DesignArgument,
    *,
    wiring: Wiring,
    calibration: Calibrated = None,
    seconds: Annotated[float, Option(min=0.0, help="How long each fiber is lit.")] = 0.5,
) -> None:
    """Light one fiber of a design after the other."""
    from hw.leds.fiber_lights import sweep
    from optimize.design import load_design_file

    with reserved_stdout() as stream:
        file = load_design_file(path)
        design, drive = file.design, _drive(file, path, calibration)
        names, palette = design.color_names, design.palette
        power = palette.in_shots(drive * wiring.scale).max(axis=0)
        with wiring.lights(*power.shape) as lights, ProgressBar("Sweeping") as bar:
            for done, fiber in enumerate(sweep(lights, power, seconds)):
                led = lights.channels.led(fiber, int(palette.led[design.colors[fiber]]))
                stream.write(f"fiber {fiber}, LED {led}: {names[fiber]}\n")
                stream.flush()
                bar(Progress(done + 1, _lit(design.drive)))
        stream.write("All LEDs are off.\n")


def off(
    port: Port = None,
    protocol: SpokenProtocol = ProtocolName.LINES,
    baud: Baud = 115200,
    count: Annotated[
        int | None, Option(min=1, max=65536, help="LEDs of a board that cannot say (64).")
    ] = None,
) -> None:
    """Switch all LEDs of a board off."""
    from hw.leds.board import dark
    from hw.leds.ports import open_board, the_port

    with reserved_stdout() as stream:
        told = protocol is not ProtocolName.ADALIGHT
        leds = count or (1 if told else UNTOLD_LEDS)
        board = open_board(the_port(port), protocol, leds=leds, baud=baud)
        try:
            board.show(dark(board.leds))
        finally:
            board.close()
        ends = "are off" if not board.unread else "were told to go off"
        stream.write(f"{board.name}: all {board.leds} LEDs {ends}.\n")


def _drive(file: DesignFile, path: Path, calibration: Path | None) -> Array:
    """Return the power ``(fiber, color)`` with which the fibers shine as the design says."""
    from hw.calibrated_powers import calibrated_powers

    power = file.design.drive
    found = calibrated_powers(calibration, path, file.scene_hash, len(power))
    if found is None:
        return power
    note(f"Powers are evened out by {found.path}: all fibers dimmed to the weakest.")
    return found.evened(power)


def in_shot(shot: int, palette: Palette, drive: Array) -> Array:
    """Return the power ``(fiber, LED)`` of ``drive`` ``(fiber, color)`` in one shot, from 1 on.

    Raises:
        PowerError: there is no such shot.
    """
    from hw.errors import PowerError

    if not 1 <= shot <= palette.shots:
        raise PowerError(
            f"--shot {shot} of a design with {palette.shots} shot{'s' * (palette.shots > 1)}, "
            f"allowed: 1{f' to {palette.shots}' * (palette.shots > 1)}",
            field="shot",
        )
    if palette.shots > 1:
        note(f"Shot {shot} of {palette.shots}: --shot shows another.")
    power: Array = palette.in_shots(drive)[shot - 1]
    return power


def only(fiber: int | None, power: Array) -> Array:
    """Return ``power`` ``(fiber, color)`` of one fiber alone, or as it is where none is named.

    Raises:
        PowerError: there is no such fiber, or the design leaves it dark.
    """
    from hw.errors import PowerError

    if fiber is None:
        return power
    lit = [index for index, one in enumerate(power) if one.any()]
    if fiber not in lit:
        raise PowerError(
            f"--fiber {fiber} is not lit by this design, allowed: one of {lit}", field="fiber"
        )
    alone = 0.0 * power
    alone[fiber] = power[fiber]
    return alone


def _lit(power: Array) -> int:
    return int((power.max(axis=1) > 0).sum())
