"""``tactilux render``: what the camera sees, at level 0 or 2."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Option

from optimize.cli.options import Bend, DesignOption, SceneName
from optimize.ui.console import ProgressBar, note, reserved_stdout

if TYPE_CHECKING:
    from optimize.design import Design
    from render.arrays import Array
    from render.scene import Scene

SAMPLES = 128  # samples per pixel at level 2, at a third of the camera's resolution: some minutes


def run(
    scene_name: SceneName = "finger20",
    design: DesignOption = None,
    bend: Bend = 0.0,
    level: Annotated[
        Literal["preview", "reference"], Option(help="Which renderer draws.")
    ] = "preview",
    out: Annotated[Path | None, Option(help="PNG file to write.")] = None,
) -> None:
    """Draw what the camera sees."""
    import numpy as np

    from optimize.design import baseline_design, load_design, load_design_file
    from optimize.report import picture_png
    from optimize.ui.output import check_file, write_result
    from render.metric import THESIS
    from render.scene import load_scene

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        path = out or Path(f"{scene.name}-{level}-{bend:g}deg.png")
        check_file(path)
        lighting = baseline_design(scene) if design is None else load_design(design, scene)
        rating = None if design is None else load_design_file(design).rating
        draw = _preview if level == "preview" else _reference
        radiance = draw(scene, lighting, math.radians(bend))
        if rating is None:
            bright = float(np.percentile(radiance, THESIS.exposure_percentile))
            exposure = THESIS.exposure_counts / bright if bright > 0 else 1.0
            note("No rated design gives the exposure, so this picture is exposed for itself.")
        else:
            exposure = rating.settings.exposure
        write_result(path, picture_png(radiance * exposure / THESIS.count_max))
        stream.write(f"{path}\n")


def _preview(scene: Scene, design: Design, bend: float) -> Array:
    from render.preview import Preview

    with Preview(scene) as preview:
        picture = preview.picture(
            design.phi, design.power, bend, scene.camera.columns, scene.camera.rows
        )
    return picture.astype(float)


def _reference(scene: Scene, design: Design, bend: float) -> Array:
    from render.reference import render_image

    with ProgressBar("Render") as bar:
        picture = render_image(
            scene,
            design.phi,
            design.power,
            bend,
            width=scene.camera.columns // 3,
            height=scene.camera.rows // 3,
            samples=SAMPLES,
            progress=bar,
        )
    return picture.radiance
