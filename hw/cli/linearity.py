"""``tactilux hw linearity``: does light add up in a camera's photographs?"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from typer import Argument

from hw.cli.options import Photographs, SceneOption, grouped
from optimize.cli.options import Json
from optimize.ui.console import print_json, reserved_stdout


@grouped
def run(
    folder: Annotated[
        Path, Argument(metavar="sweep", help="Folder of a sweep with all fibers together.")
    ],
    scene_name: SceneOption = "finger20",
    *,
    photographs: Photographs,
    as_json: Json = False,
) -> None:
    """Test whether light adds up in the photographs of a sweep."""
    from hw.camera.linearity import linearity
    from render.scene import load_scene

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        photos = photographs.reader(scene).sweep(folder)
        found = linearity(photos, photographs.noise)
        if as_json:
            print_json(stream, asdict(found))
        found.require()
        if not as_json:
            stream.write(
                f"Light adds up within {100 * found.residual:.2f} % rms: the camera is linear.\n"
            )
