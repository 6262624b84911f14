"""Arguments and options that several commands share; each is declared here alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

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
    bool, Option("--coarse", help="On the preview as drawn: seconds, not a minute, and less exact.")
]
Bend = Annotated[float, Option(min=0.0, max=180.0, help="Total bending angle in degrees.")]
Seed = Annotated[int, Option(min=0, help="Seed of all random choices.")]
Json = Annotated[bool, Option("--json", help="Print one JSON object on stdout.")]
