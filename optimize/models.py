"""Finding the surrogate model of a scene."""

from __future__ import annotations

from pathlib import Path

from render.errors import ModelError


def find_model(scene_name: str, given: Path | None = None) -> Path:
    """Return the folder that holds ``checker.onnx`` for a scene.

    Looked for in this order: the folder given, ``models/<scene>`` in the current directory, and
    ``models/<scene>`` in the checkout that the program runs from.

    Raises:
        ModelError: there is none; the message says how to get one.
    """
    checkout = Path(__file__).resolve().parents[1]
    places = [given] if given else [Path("models") / scene_name, checkout / "models" / scene_name]
    for place in places:
        if (place / "checker.onnx").is_file():
            return place
    looked = " or ".join(str(place) for place in places)
    raise ModelError(
        f"there is no model for scene {scene_name} in {looked}: "
        "name its folder with --model or make one with tactilux train",
        field="model",
        value=looked,
    )
