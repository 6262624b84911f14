"""The depth that designs read of one press: a table, and maps of it on one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

import numpy as np
from matplotlib.figure import Figure

from optimize.readers import FRAMES, HEIGHTS, CameraModel, DepthReading
from optimize.readers.camera_model import FULL_SCALE
from optimize.report.illustrations import drawing, picture_png, png_bytes
from optimize.report.page import data_uri, render_page
from optimize.ui.console import print_table
from optimize.ui.output import write_result
from optimize.ui.provenance import package_versions
from render.scene import Scene

HEAD = ("design", "rms (µm)", "worst (µm)", "ball detected (µm)", "clipped")
LEGEND = (
    "rms: error of the depth where skin is pressed in; worst: there and in the field of the sites. "
    "Detected: from which depth on a ball of 2 mm peaks above what 99 of 100 pictures of the "
    "untouched pad show. Clipped: fraction of pressed pixels that were read as steeper than the "
    "indenter, and taken for as steep."
)


def print_depths(stream: IO[str], title: str, found: Mapping[str, DepthReading]) -> None:
    """Print the figures of each design."""
    print_table(stream, title, HEAD, _rows(found), below=LEGEND)


def write_depths(
    path: Path,
    scene: Scene,
    press: str,
    found: Mapping[str, DepthReading],
    camera: CameraModel,
    seed: int,
) -> None:
    """Write the page of what each design reads of ``press``, with every picture inside."""
    maps = depth_maps(scene, list(found.values()))
    show = scene.palette.shown
    context = {
        "scene": scene.name,
        "scene_hash": scene.hash,
        "press": press,
        "bends": ("",),
        "made": datetime.now(UTC).strftime("%d %B %Y, %H:%M UTC"),
        "deepest": f"{max(np.nanmax(one.true) for one in found.values()):.3g}",
        "head": [name.capitalize() if name == "design" else name for name in HEAD],
        "rows": _rows(found),
        "legend": LEGEND,
        "frames": FRAMES,
        "entries": [
            {
                "title": title,
                "picture": data_uri(picture_png(show(one.picture / FULL_SCALE))),
                "maps": data_uri(png_bytes(figure)),
            }
            for (title, one), figure in zip(found.items(), maps, strict=True)
        ],
        "facts": [
            ("Camera", f"{scene.camera.columns} x {scene.camera.rows} pixels, read noise "
             f"{camera.read_noise:g} counts, {camera.full_well:g} electrons at 255 counts"),
            ("Seed", str(seed)),
            ("Versions", ", ".join(f"{name} {version}" for name, version in
                                   package_versions("numpy", "scipy", "moderngl").items())),
        ],
    }  # fmt: skip
    write_result(path, render_page("depth.html.j2", context).encode())


def depth_maps(scene: Scene, readings: Sequence[DepthReading]) -> list[Figure]:
    """Draw true and recovered depth in mm and their difference in micrometers, one figure each.

    All share their scales.
    """
    half_width, half_length = scene.pad.width / 2, scene.pad.length / 2
    extent = (-half_width, half_width, -half_length, half_length)
    top = max(float(np.nanmax([one.true, one.recovered])) for one in readings)
    off = [1000.0 * (one.recovered - one.true) for one in readings]
    worst = max(float(np.nanmax(np.abs(one))) for one in off)
    figures = []
    for one, error in zip(readings, off, strict=True):
        with drawing(6.6, 0.5 + 2.0 * scene.pad.length / scene.pad.width) as figure:
            true, recovered, apart = figure.subplots(1, 3, sharex=True, sharey=True)
            for axes, values in ((true, one.true), (recovered, one.recovered)):
                depth = axes.imshow(
                    values, origin="lower", extent=extent, cmap="viridis", vmin=0.0, vmax=top
                )
            errors = apart.imshow(
                error, origin="lower", extent=extent, cmap="RdBu_r", vmin=-worst, vmax=worst
            )
            for axes, title in ((true, "true"), (recovered, "recovered"), (apart, "difference")):
                axes.set_title(title)
                axes.set(xticks=[], yticks=[])
            figure.colorbar(depth, ax=[true, recovered], location="bottom", label="mm", aspect=30)
            figure.colorbar(errors, ax=[apart], location="bottom", label="µm", aspect=15)
        figures.append(figure)
    return figures


def _rows(found: Mapping[str, DepthReading]) -> list[tuple[str, ...]]:
    return [
        (
            title,
            f"{one.depth_rms_um:.1f}",
            f"{one.depth_worst_um:.1f}",
            f"{one.detected_um:.1f}" if one.detected_um else f"not to {1000 * HEIGHTS[-1]:g}",
            f"{one.clipped:.1%}",
        )
        for title, one in found.items()
    ]
