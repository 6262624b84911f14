"""Options that several commands of the rig share; each is declared here alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

SceneOption = Annotated[str, Option("--scene", help="Name of a shipped scene, or a TOML file.")]
Lens = Annotated[
    Path | None, Option(help="Fisheye lens, a TOML file (default: photographs are pinhole).")
]
Gamma = Annotated[float, Option(min=0.2, max=5.0, help="Gamma of the photographs (1: linear).")]
Noise = Annotated[float, Option(min=0.01, help="Noise of one pixel of the photographs, in counts.")]
Calibrated = Annotated[
    Path | None,
    Option("--calibration", help="calibration.json (default: one beside the design or scene)."),
]
Samples = Annotated[
    int, Option(min=0, help="Light paths per fiber and cell of all renders (0: no renders).")
]
Materials = Annotated[
    int, Option(min=1, max=64, help="Materials rendered once for all rigs of a design, and kept.")
]
