"""``tactilux schema``: what a scene file may hold, for editors."""

from __future__ import annotations

from optimize.ui.console import reserved_stdout


def run() -> None:
    """Print the JSON schema of scene files, for editors."""
    import json

    from render.scene.json_schema import scene_schema

    with reserved_stdout() as stream:
        stream.write(json.dumps(scene_schema(), indent=2) + "\n")
