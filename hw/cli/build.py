"""``tactilux build``: from a design to the scene file of the sensor that it is."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

from typer import Option

from optimize.cli.options import DesignArgument, Json, SceneOfDesign
from optimize.ui.console import counted, note, print_json, reserved_stdout
from render.errors import SceneError


def run(
    path: DesignArgument,
    out: Annotated[
        Path | None, Option(help="The file (default: <scene>-built.toml); its name is the scene's.")
    ] = None,
    scene: SceneOfDesign = None,
    as_json: Json = False,
) -> None:
    """Write the scene file of the sensor that a design is."""
    from optimize.design import load_layout
    from optimize.placement import PLACES, built_scene, unsaid_powers
    from optimize.ui.output import check_file, writable
    from render.scene import standalone

    with reserved_stdout() as stream:
        sensor, design = load_layout(path, scene)
        target = out or Path(f"{sensor.name.removesuffix(PLACES)}-built.toml")
        check_file(target, (".toml",))
        built = built_scene(sensor, design, target.stem)
        kept = standalone(built)
        for file, content in kept.contents(target).items():
            if file.exists() and (file == target or file.read_bytes() != content):
                raise SceneError(f"{file} is there: name another file with --out", field="out")
        with writable(target):
            kept.write(target)
        for told in unsaid_powers(design):
            note(told)
        if as_json:
            result: dict[str, object] = {"scene": built.name, "scene_hash": built.hash}
            print_json(stream, result | {"file": str(target), "lamps": built.lamp_count})
            return
        stream.write(
            f"{counted(built.lamp_count, 'lamp')} of {sensor.lamp_count}, as the baseline of "
            f"{built.name}.\nScene: {target}, go on with tactilux explore "
            f"{shlex.quote(str(target))}\n"
        )
