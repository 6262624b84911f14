"""``tactilux describe``: a scene in plain words."""

from __future__ import annotations

from optimize.ui.console import print_json, reserved_stdout
from render.describe import describe
from render.scene.schema import load_scene, sources


def run(scene_name: str, *, as_json: bool) -> None:
    """Print what a scene declares, with the source of every value, and what is left out."""
    with reserved_stdout() as stream:
        description = describe(load_scene(scene_name), sources(scene_name))
        if as_json:
            print_json(stream, description.to_json())
        else:
            stream.write(description.text() + "\n")
