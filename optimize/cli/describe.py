"""``tactilux describe``: a scene in plain words."""

from __future__ import annotations

from optimize.cli.options import Json, SceneName
from optimize.ui.console import print_json, reserved_stdout


def run(scene_name: SceneName = "finger20", as_json: Json = False) -> None:
    """Say what a scene models and leaves out."""
    from render.describe import describe
    from render.scene import load_scene, sources

    with reserved_stdout() as stream:
        description = describe(load_scene(scene_name), sources(scene_name))
        if as_json:
            print_json(stream, description.to_json())
        else:
            stream.write(description.text() + "\n")
