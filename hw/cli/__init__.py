"""The whole program: the commands of `optimize.cli`, and those that need a rig.

This package is the console script, because ``hw`` may import ``optimize`` and not the other way
round. As there, the signature of a command declares its options.
"""

from __future__ import annotations

import typer

from hw.cli import (
    build,
    calibrate,
    capture,
    check,
    demo,
    emulate,
    lights,
    linearity,
    parts,
    wiring_sheet,
)
from optimize.cli import app, main
from optimize.ui.command import Command

rig = typer.Typer(
    name="hw",
    help="Drive LEDs and camera, calibrate, or play without a rig.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
rig.command("ports", cls=Command)(lights.ports)
rig.command("set", cls=Command)(lights.set_lights)
rig.command("sweep", cls=Command)(lights.sweep_lights)
rig.command("off", cls=Command)(lights.off)
rig.command("capture", cls=Command)(capture.run)
rig.command("calibrate", cls=Command)(calibrate.run)
rig.command("linearity", cls=Command)(linearity.run)
rig.command("emulate", cls=Command)(emulate.run)
rig.command("demo", cls=Command)(demo.run)
app.add_typer(rig)
app.command("check", cls=Command)(check.run)
app.command("wiring", cls=Command)(wiring_sheet.run)
app.command("build", cls=Command)(build.run)
app.command("parts", cls=Command)(parts.run)
