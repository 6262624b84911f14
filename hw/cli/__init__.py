"""The whole program: the commands of `optimize.cli`, and those that need a rig.

This package is the console script, because ``hw`` may import ``optimize`` and not the other way
round. As there, the signature of a command declares its options.
"""

from __future__ import annotations

import typer

from hw.cli import (
    calibrate,
    capture,
    check,
    demo,
    emulate,
    lights,
    linearity,
    wiring_sheet,
)
from optimize.cli import app, main

rig = typer.Typer(
    name="hw",
    help="Drive LEDs and camera, calibrate, or play without a rig.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
rig.command("ports")(lights.ports)
rig.command("set")(lights.set_lights)
rig.command("sweep")(lights.sweep_lights)
rig.command("off")(lights.off)
rig.command("capture")(capture.run)
rig.command("calibrate")(calibrate.run)
rig.command("linearity")(linearity.run)
rig.command("emulate")(emulate.run)
rig.command("demo")(demo.run)
app.add_typer(rig)
app.command("check")(check.run)
app.command("wiring")(wiring_sheet.run)
