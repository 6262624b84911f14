"""The calibration's report: one HTML file with measured and simulated curves overlaid."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from hw.calibration.measurement import Measurement
from hw.calibration.reference_lines import NAMES as LINES
from hw.calibration.reference_lines import ReferenceLines, Setup
from hw.calibration.rig_fit import Calibration
from optimize.report import data_uri, render_page
from render.arrays import Array

SHOWN = 6
"""Photographs whose curves are drawn, spread evenly over all."""
COLORS = ("#d43d3d", "#1f9d55", "#2f66d0")


def render_report(
    setup: Setup, result: Mapping[str, Any], found: Calibration, measurements: list[Measurement]
) -> str:
    """Return the HTML text; everything is inside the one file.

    Arguments:
        setup: before calibration.
        result: what ``calibration.json`` holds.
        found: the calibration.
        measurements: the photographs.
    """
    shown = np.unique(np.linspace(0, len(measurements) - 1, SHOWN).round().astype(int)).tolist()
    figures = []
    for one, predicted in ((measurements[index], found.predicted[index]) for index in shown):
        title = f"Fiber {one.fiber}, bend {np.degrees(setup.bends[one.bend]):.0f} deg"
        curves = draw_curves(setup.lines, one, found.tilt, predicted)
        figures.append({"title": title, "plot": data_uri(curves)})
    told = {"name": setup.scene.name, "count": len(measurements), "figures": figures}
    return render_page("calibration.html.j2", {**result, **told}, package="hw")


def draw_curves(lines: ReferenceLines, one: Measurement, tilt: Array, predicted: Array) -> bytes:
    """Return a PNG of the four lines of one photograph: dots measured, lines simulated.

    Arguments:
        lines: of the scene.
        one: the photograph.
        tilt: ``(3,)`` rad of the camera, undone.
        predicted: ``(point, 3)`` counts.
    """
    import matplotlib

    matplotlib.use("agg")
    from matplotlib.figure import Figure

    seen = one.untilted(tilt)
    figure = Figure(figsize=(11, 2.6), layout="constrained")
    axes = figure.subplots(1, 4, sharey=True)
    for line, plot in enumerate(axes):
        on = (lines.line == line) & one.used
        for channel in one.channels:
            color = COLORS[channel]
            plot.plot(lines.place[on], predicted[on, channel], color=color, lw=1.4)
            plot.plot(lines.place[on], seen[on, channel], ".", color=color, ms=4)
        plot.set_title(LINES[line], fontsize=9)
        plot.set_xlabel("mm")
        plot.grid(alpha=0.25)
    axes[0].set_ylabel("counts")
    axes[0].set_ylim(bottom=0)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=130)
    return stream.getvalue()
