"""``tactilux describe``: a scene in plain words, and as a drawing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from optimize.cli.options import Json, SceneName
from optimize.ui.console import print_json, reserved_stdout


def run(
    scene_name: SceneName = "finger20",
    out: Annotated[Path | None, Option(help="Draw the sensor into this .svg file.")] = None,
    as_json: Json = False,
) -> None:
    """Say what a scene models and leaves out, and draw it."""
    from optimize.ui.output import check_file, write_result
    from render.describe import describe
    from render.scene import load_scene, sources
    from render.sensor_drawing import sensor_svg

    with reserved_stdout() as stream:
        if out is not None:
            check_file(out, (".svg",))
        scene = load_scene(scene_name)
        if out is not None:
            # Drawn first: a camera that sees no site is refused, and the drawing says why.
            write_result(out, sensor_svg(scene, dark=True).encode())
        description = describe(scene, sources(scene))
        if as_json:
            print_json(stream, description.to_json())
        else:
            stream.write(description.text() + "\n")
