"""``tactilux render``: what the camera sees, by the preview or by the reference."""

from __future__ import annotations

import io
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import BadParameter, Option

from optimize.cli.options import (
    MAX_MINUTES,
    MAX_SMOOTHING,
    Bend,
    DesignOption,
    MeshUnit,
    SceneName,
    Seed,
    StateName,
    in_pose,
)
from optimize.ui.console import ProgressBar, note, reserved_stdout
from render.errors import GraphicsError, RenderError, TableError

if TYPE_CHECKING:
    from optimize.design import Design
    from render.arrays import Array
    from render.geometry import HeightMap, Imprint
    from render.scene import Scene

SAMPLES = 256
"""Samples per pixel of the reference: about a minute, and 4 % of noise on the coating of `finger20`
once it is smoothed."""
SHRINK = 3
"""How many times fewer columns and rows than the camera's a rendered picture has by default."""
SIZES = 16, 4096
PICTURES, DATA = (".png", ".jpg", ".jpeg"), (".npz", ".exr")
"""Files for eyes, and files of linear radiance without smoothing and exposure."""


def _size(text: str | None) -> tuple[int, int] | None:
    """Return width and height.

    Raises:
        BadParameter: ``text`` is not of the form 120x200.
    """
    if text is None:
        return None
    found = re.fullmatch(r"(\d+)[xX](\d+)", text.strip())
    if not found or not all(SIZES[0] <= int(side) <= SIZES[1] for side in found.groups()):
        raise BadParameter(
            f"--size {text!r}, allowed: width x height in pixels, {SIZES[0]} to {SIZES[1]} each, "
            "such as 240x400"
        )
    return int(found[1]), int(found[2])


def run(
    scene_name: SceneName = "finger20",
    design: DesignOption = None,
    bend: Bend = 0.0,
    state: StateName = None,
    level: Annotated[
        Literal["preview", "reference"], Option(help="Which renderer draws.")
    ] = "preview",
    press: Annotated[
        str,
        Option(
            help="What is pressed in: none, pyramids, ball, bolt, edge, or the lower side of an "
            "STL, PLY or OBJ file."
        ),
    ] = "pyramids",
    unit: MeshUnit = None,
    depth: Annotated[
        float | None,
        Option(min=0.01, help="How deep ball, bolt, edge or file are pressed in, mm (default: 1)."),
    ] = None,
    smooth: Annotated[
        float | None,
        Option(
            min=0.0,
            max=MAX_SMOOTHING,
            help="Over how many mm skin rounds what is sharp (default: 0.3 for files, else 0).",
        ),
    ] = None,
    size: Annotated[str | None, Option(help="Width x height in pixels, such as 240x400.")] = None,
    mirror: Annotated[
        bool, Option("--mirror", help="The mirror image: the skin from outside, as in reports.")
    ] = False,
    samples: Annotated[
        int | None, Option(min=1, help=f"Level reference: per pixel (default: {SAMPLES}).")
    ] = None,
    minutes: Annotated[
        float | None,
        Option(min=0.1, max=MAX_MINUTES, help="Level reference: time for everything, instead."),
    ] = None,
    seed: Seed = 1,
    out: Annotated[
        Path | None, Option(help="File to write: .png, .jpg; .npz, .exr for linear radiance.")
    ] = None,
) -> None:
    """Draw what the camera sees."""
    began = time.monotonic()
    wanted = _size(size)
    if samples is not None and minutes is not None:
        raise BadParameter("give --samples or --minutes, not both")
    if level == "preview" and (samples is not None or minutes is not None):
        raise BadParameter("--samples and --minutes are for --level reference: a preview has none")

    from optimize.design import baseline_design, load_design
    from optimize.ui.output import check_file, write_result
    from render.geometry import HeightMap, probe
    from render.metric import THESIS
    from render.scene import load_scene

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        posed, angle, _, pose = in_pose(scene, state, bend)
        path = Path(f"{scene.name}-{level}-{pose}.png") if out is None else out
        check_file(path, PICTURES + DATA)
        imprint = probe(posed, press, depth, smooth, unit)
        if isinstance(imprint, HeightMap) and imprint.about:
            note(f"{imprint.about}.")
        lighting = baseline_design(scene) if design is None else load_design(design, scene)
        exposure = _scene_exposure(scene)
        if level == "preview":
            columns, rows = wanted or (scene.camera.columns, scene.camera.rows)
            light = _preview(posed, lighting, angle, columns, rows, press, imprint)
            arrays, coated = {"radiance": light}, light.sum(axis=-1) > 0
        else:
            from render.reference import TimeBudget, ensure_llvm, render_image, smoothed

            ensure_llvm()
            camera = scene.camera
            columns, rows = wanted or (camera.columns // SHRINK, camera.rows // SHRINK)
            with ProgressBar("Render") as bar:
                picture = render_image(
                    posed,
                    lighting.phi,
                    lighting.power,
                    angle,
                    width=columns,
                    height=rows,
                    samples=samples or SAMPLES,
                    seed=seed,
                    indented=press != "none",
                    imprint=imprint,
                    budget=None if minutes is None else TimeBudget.of_minutes(minutes, began),
                    progress=bar,
                )
            shown = smoothed(picture)
            note(
                f"Noise of a pixel: {picture.noise:.0%}, and {shown.noise:.1%} smoothed over "
                "pixels nearby that see the same face."
            )
            light, arrays = shown.radiance, {"radiance": picture.radiance, "se": picture.se}
            coated = picture.coated
        if exposure is None:
            exposure = _own_exposure(light[coated])
        # Renderers draw the skin from outside; the camera looks from within.
        turned = slice(None) if mirror else slice(None, None, -1)
        if path.suffix.lower() in DATA:
            arrays = {name: values[:, turned] for name, values in arrays.items()}
            content = _data(path, {**arrays, "exposure": exposure})
        else:
            counts = light[:, turned] * exposure
            content = _encoded(path, scene.palette.shown(counts / THESIS.count_max))
        write_result(path, content)
        stream.write(f"{path}\n")


def _scene_exposure(scene: Scene) -> float | None:
    """Return the scene's exposure, so that its pictures compare; None where it is not known."""
    from render.choose_exposure import scene_scale

    try:
        return scene_scale(scene).exposure
    except (TableError, GraphicsError, RenderError):
        return None


def _own_exposure(lit: Array) -> float:
    """Return the exposure of a picture alone, whose pad's light ``(pixel, channel)`` is ``lit``.

    However much of the picture the pad fills, its brightest parts have the same counts.
    """
    import numpy as np

    from render.metric import THESIS

    note(
        "The preview of the baseline gives no exposure: the brightest parts of this picture "
        f"are set to {THESIS.exposure_counts:g} counts, and compare with no other."
    )
    bright = float(np.percentile(lit, THESIS.exposure_percentile)) if lit.size else 0.0
    return THESIS.exposure_counts / bright if bright > 0 else 1.0


def _preview(
    scene: Scene,
    design: Design,
    bend: float,
    columns: int,
    rows: int,
    press: str,
    imprint: Imprint | HeightMap | None,
) -> Array:
    from render.preview import Preview

    with Preview(scene, imprint=imprint) as preview:
        picture = preview.picture(
            design.phi, design.power, bend, columns, rows, indented=press != "none"
        )
    return picture.astype(float)


def _encoded(path: Path, linear: Array) -> bytes:
    """Return an image file of linear values, 1 being full white."""
    from optimize.report import encode_srgb, picture_png

    if path.suffix.lower() == ".png":
        return picture_png(linear)
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(encode_srgb(linear)).save(stream, format="JPEG", quality=92)
    return stream.getvalue()


def _data(path: Path, arrays: dict[str, Array | float]) -> bytes:
    """Return a file of linear radiance; ``.npz`` has its standard error and the exposure too."""
    import numpy as np

    if path.suffix.lower() == ".npz":
        stream = io.BytesIO()
        np.savez(stream, **arrays)  # type: ignore[arg-type]
        return stream.getvalue()
    from render.reference import mitsuba

    mi = mitsuba()
    written = mi.MemoryStream()
    picture = mi.Bitmap(np.ascontiguousarray(arrays["radiance"], dtype=np.float32))
    picture.write(written, mi.Bitmap.FileFormat.OpenEXR)
    content: bytes = written.raw_buffer()
    return content
