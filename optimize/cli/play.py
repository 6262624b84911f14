"""``tactilux play``: one HTML page on which to move the light."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from optimize.cli.options import Coarse, Json, ModelFolder, Objective, SceneOfDesign
from optimize.ui.console import ProgressBar, note, print_json, reserved_stdout
from render.progress import in_stage


def run(
    what: Annotated[
        str,
        Argument(
            metavar="[SCENE | DESIGN]", help="A shipped scene, a TOML file, or a design.json."
        ),
    ] = "finger20",
    scene: SceneOfDesign = None,
    model: ModelFolder = None,
    coarse: Coarse = False,
    objective: Objective = None,
    out: Annotated[Path | None, Option(help="The page (default: <scene>-play.html).")] = None,
    as_json: Json = False,
) -> None:
    """Make a page on which to move lamps and see what changes."""
    from optimize.design import load_layout
    from optimize.play import PlayPage, write_play
    from optimize.scoring import open_model
    from optimize.ui.output import check_file
    from render.scene import load_scene

    with reserved_stdout() as stream:
        start = None
        if Path(what).suffix.lower() == ".json":
            sensor, start = load_layout(Path(what), scene)
        else:
            sensor = load_scene(scene or what)
        path = out or Path(f"{sensor.name}-play.html")
        check_file(path, (".html", ".htm"))
        checker = open_model(sensor, model, coarse=coarse)
        note(f"Making a page of {sensor.name}")
        command = f"tactilux play {shlex.quote(what)}" + (" --coarse" if coarse else "")
        command += f" --objective {objective}" if objective else ""
        goal = objective or "sensor"
        page = PlayPage(sensor, checker, start=start, objective=goal, command=command)
        with ProgressBar() as bar:
            write_play(path, page, in_stage(bar, f"for the {goal} reader"))
        result: dict[str, object] = {
            "scene": sensor.name,
            "scene_hash": sensor.hash,
            "page": str(path),
            "bytes": path.stat().st_size,
        }
        if as_json:
            print_json(stream, result)
        else:
            stream.write(f"Page: {path}, open it in a browser\n")
