"""Arguments and options that several commands share; each is declared here alone."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from typer import Argument, BadParameter, Option

from optimize.objectives import ObjectiveName
from render.mesh_units import Unit

if TYPE_CHECKING:
    from render.scene import Scene

SceneName = Annotated[
    str, Argument(metavar="scene", help="Name of a shipped scene, or a TOML file.")
]
DesignArgument = Annotated[
    Path, Argument(metavar="design", help="The design.json that explore wrote.")
]
RatedDesignArgument = Annotated[Path, Argument(metavar="design", help="A rated design.json.")]
DesignOption = Annotated[Path | None, Option(help="A design.json (default: the baseline design).")]
SceneOfDesign = Annotated[
    str | None, Option(help="Scene file, where the design's scene is not a shipped one.")
]
ModelFolder = Annotated[
    Path | None, Option(help="Folder with checker.onnx (default: found by the scene's hash).")
]
Coarse = Annotated[
    bool, Option("--coarse", help="On the preview alone: seconds, not minutes, and less exact.")
]
Bend = Annotated[float, Option(min=0.0, max=180.0, help="Total bending angle in degrees.")]
StateName = Annotated[
    str | None, Option(help="State of the skin by its name, where the scene has states.")
]
MeshUnit = Annotated[
    Unit | None, Option(help="Unit of the file (default: what it says, or what fits the pad).")
]
MAX_SMOOTHING = 3.0
"""Longest length over which skin can be told to round what is sharp, mm."""
MAX_MINUTES = 6e5
"""Over a year: what is more is a mistake, and its rest has no date."""
Seed = Annotated[int, Option(min=0, help="Seed of all random choices.")]
Objective = Annotated[
    ObjectiveName | None,
    Option(
        help="What improves: degrees of one reader for the whole sensor (default), of one that "
        "knows every place, or the score S."
    ),
]
Json = Annotated[bool, Option("--json", help="Print one JSON object on stdout.")]


class Pose(NamedTuple):
    """A sensor that stays in one state.

    Arguments:
        scene: the sensor of that state alone.
        bend: rad, 0 where the states are named.
        number: what stands for the state on the axis of transport and models: the bend in rad, or
            the number of the named state.
        name: what files call it.
    """

    scene: Scene
    bend: float
    number: float
    name: str


def in_pose(scene: Scene, state: str | None, bend: float) -> Pose:
    """Return ``scene`` in the ``state`` of that name, at rest without one, or at ``bend`` deg.

    Raises:
        BadParameter: the scene has no such state, or has states and does not bend.
    """
    from render.geometry import in_state
    from render.refused_values import did_you_mean

    if scene.states is None:
        if state is not None:
            raise BadParameter(
                f"--state {state}: {scene.name} has no states, allowed: a scene with [[states]]; "
                "slabs have --bend"
            )
        angle = math.radians(bend)
        return Pose(scene, angle, angle, f"{bend:g}deg")
    if bend:
        raise BadParameter(f"--bend {bend:g}: {scene.name} does not bend, allowed: --state")
    name = scene.state_names[0] if state is None else state
    if name not in scene.state_names:
        meant = did_you_mean(name, scene.state_names)
        raise BadParameter(f"--state {name}, allowed: {', '.join(scene.state_names)}{meant}")
    number = float(scene.state_names.index(name))
    return Pose(*in_state(scene, number), number, name)
