"""``tactilux hw linearity``: does light add up in a camera's photographs?"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from typer import Argument

from hw.cli.options import Gamma, Noise, SceneOption
from hw.errors import CaptureError
from optimize.cli.options import Json
from optimize.ui.console import print_json, reserved_stdout


def run(
    folder: Annotated[
        Path, Argument(metavar="sweep", help="Folder of a sweep with all fibers together.")
    ],
    scene_name: SceneOption = "finger20",
    gamma: Gamma = 1.0,
    noise: Noise = 2.55,
    as_json: Json = False,
) -> None:
    """Test whether light adds up in the photographs of a sweep."""
    import numpy as np

    from hw.camera.linearity import linearity
    from hw.camera.photo_set import load_photo_set
    from render.scene import load_scene

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        size, channels = (scene.camera.rows, scene.camera.columns), len(scene.palette.channels)
        photos = load_photo_set(folder, *size, gamma, channels)
        if photos.together is None:
            raise CaptureError(
                f"{folder} holds no photograph of all fibers together (all.png or all.npy): "
                "capture the sweep again",
                field="sweep",
            )
        found = linearity(np.stack(list(photos.alone.values())), photos.together, noise)
        if as_json:
            print_json(stream, asdict(found))
        found.require()
        if not as_json:
            stream.write(
                f"Light adds up within {100 * found.residual:.2f} % rms: the camera is linear.\n"
            )
