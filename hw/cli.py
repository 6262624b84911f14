"""The whole program: the commands of `optimize.cli`, and those that need a rig.

This module is the console script, because ``hw`` may import ``optimize`` and not the other way
round. Only options are declared here; the work is in ``hw/commands``, imported when it runs.
"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from optimize.cli import Json, Model, Scene, Seed, app, main

rig = typer.Typer(
    name="hw",
    help="Drive LEDs and camera of a rig, calibrate the scene to it, or play with an emulated one.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.add_typer(rig)


class Speech(StrEnum):
    """What the LED board speaks."""

    LINES = "lines"
    WLED = "wled"
    ADALIGHT = "adalight"


Port = Annotated[
    str | None, typer.Option(help="Serial port (default: the only one; see `tactilux hw ports`).")
]
Protocol = Annotated[Speech, typer.Option(help="What the LED board speaks.")]
Baud = Annotated[int, typer.Option(min=1200, help="Bits per second.")]
Leds = Annotated[
    str | None, typer.Option(help="LED of each fiber, like 0,1,2 (default: in their order).")
]
Order = Annotated[str, typer.Option(help="How the LEDs' channels are wired: rgb, grb, ...")]
Limit = Annotated[float, typer.Option(min=1.0, help="Current that the supply may give, in mA.")]
Scale = Annotated[float, typer.Option(min=0.0, max=1.0, help="Factor on all powers.")]
DesignFile = Annotated[Path, typer.Argument(help="The design.json that explore wrote.")]


@rig.command()
def ports(json: Json = False) -> None:
    """List the serial ports that LED boards may be on."""
    from hw.commands import lights as command

    command.ports(as_json=json)


@rig.command("set")
def set_lights(
    design: DesignFile,
    port: Port = None,
    protocol: Protocol = Speech.LINES,
    baud: Baud = 115200,
    leds: Leds = None,
    order: Order = "rgb",
    limit_ma: Limit = 500.0,
    scale: Scale = 1.0,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="How long (default: until Ctrl-C).")
    ] = None,
) -> None:
    """Light the fibers as a design says; off when the command ends."""
    from hw.commands import lights as command

    wiring = command.Wiring(port, protocol.value, baud, leds, order, limit_ma, scale)
    command.set_lights(design, wiring, seconds=seconds)


@rig.command()
def sweep(
    design: DesignFile,
    port: Port = None,
    protocol: Protocol = Speech.LINES,
    baud: Baud = 115200,
    leds: Leds = None,
    order: Order = "rgb",
    limit_ma: Limit = 500.0,
    scale: Scale = 1.0,
    seconds: Annotated[float, typer.Option(min=0.0, help="How long each fiber is lit.")] = 0.5,
) -> None:
    """Light one fiber of a design after the other."""
    from hw.commands import lights as command

    wiring = command.Wiring(port, protocol.value, baud, leds, order, limit_ma, scale)
    command.sweep_lights(design, wiring, seconds=seconds)


@rig.command()
def off(
    port: Port = None,
    protocol: Protocol = Speech.LINES,
    baud: Baud = 115200,
    count: Annotated[
        int | None, typer.Option(min=1, max=65536, help="LEDs of a board that cannot say (64).")
    ] = None,
) -> None:
    """Switch all LEDs of a board off."""
    from hw.commands import lights as command

    command.off(port, protocol.value, baud, count=count)


__all__ = ["Model", "Scene", "Seed", "app", "main"]

if __name__ == "__main__":
    main()
