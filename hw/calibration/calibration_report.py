"""The calibration's report: one HTML file with measured and simulated curves overlaid."""

from __future__ import annotations

import io

import numpy as np

from hw.calibration.material import NAMES, PER_UNIT, UNITS, Material
from hw.calibration.measurement import Measurement
from hw.calibration.reference_lines import NAMES as LINES
from hw.calibration.reference_lines import reference_lines
from hw.calibration.refine import Confirmation
from hw.calibration.rig_fit import Calibration
from hw.camera.linearity import Linearity
from optimize.report import data_uri, render_page
from optimize.scoring import normal_factor
from render.arrays import Array
from tactilux import Scene

SHOWN = 6
"""Photographs whose curves are drawn, spread evenly over all."""
COLORS = ("#d43d3d", "#1f9d55", "#2f66d0")
TITLES = {
    "reduced_scattering": "reduced scattering",
    "absorption": "absorption",
    "sigma_v": "beam width sigma_v",
    "roughness": "roughness alpha",
}


def render_report(
    scene: Scene,
    found: Calibration,
    measurements: list[Measurement],
    bends: Array,
    linearity: Linearity,
    confirmation: Confirmation | None,
    date: str,
) -> str:
    """Return the HTML text; everything is inside the one file.

    Arguments:
        scene: before calibration.
        found: the calibration.
        measurements: the photographs.
        bends: ``(bend,)`` rad.
        linearity: of the camera.
        confirmation: by renders; None where nothing was rendered.
        date: ISO date.
    """
    shown = np.unique(np.linspace(0, len(measurements) - 1, SHOWN).round().astype(int)).tolist()
    fibers = np.nonzero(np.isfinite(found.power))[0].tolist()
    figures = []
    for index in shown:
        one = measurements[index]
        title = f"Fiber {one.fiber}, bend {np.degrees(bends[one.bend]):.0f} deg"
        curves = draw_curves(scene, one, found.tilt, found.predicted[index])
        figures.append({"title": title, "plot": data_uri(curves)})
    return render_page(
        "calibration.html.j2",
        {
            "name": scene.name,
            "date": date,
            "count": len(measurements),
            "rows": value_rows(scene, found),
            "powers": [
                {
                    "fiber": fiber,
                    "power": f"{found.power[fiber]:.3f}",
                    "error": f"{normal_factor() * se * found.power[fiber]:.3f}",
                }
                for fiber, se in zip(fibers, found.errors.power, strict=True)
            ],
            "gains": [f"{gain:.4g}" for gain in found.gain if np.isfinite(gain)],
            "tilt": ", ".join(f"{np.degrees(angle):+.2f}" for angle in found.tilt),
            "vignetting": f"{100 * found.vignetting:.0f}",
            "chi": f"{found.chi:.2f}",
            "linear": f"{100 * linearity.residual:.2f}",
            "inseparable": [
                f"{TITLES[a]} and {TITLES[b]} (correlation {value:+.2f})"
                for a, b, value in found.errors.inseparable()
            ],
            "confirmation": confirmation,
            "figures": figures,
        },
        package="hw",
    )


def value_rows(scene: Scene, found: Calibration) -> list[dict[str, str]]:
    """Return the fitted values as text: value, interval, the scene's before, error by source."""
    before = PER_UNIT * Material.of(scene).array()
    values = PER_UNIT * found.material.array()
    rows = []
    for index, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
        low, high = (PER_UNIT[index] * end for end in found.intervals[index])
        rows.append(
            {
                "title": TITLES[name],
                "value": f"{values[index]:.4g} {unit}".rstrip(),
                "interval": f"{low:.4g} to {high:.4g}",
                "before": f"{before[index]:.4g}",
                "sources": ", ".join(
                    f"{source} {PER_UNIT[index] * part[index]:.2g}"
                    for source, part in found.errors.parts.items()
                ),
            }
        )
    return rows


def draw_curves(scene: Scene, one: Measurement, tilt: Array, predicted: Array) -> bytes:
    """Return a PNG of the four lines of one photograph: dots measured, lines simulated.

    Arguments:
        scene: whose lines these are.
        one: the photograph.
        tilt: ``(3,)`` rad of the camera, undone.
        predicted: ``(point, 3)`` counts.
    """
    import matplotlib

    matplotlib.use("agg")
    from matplotlib.figure import Figure

    lines = reference_lines(scene)
    seen = one.counts + np.einsum("tpc,t->pc", one.tilt_slope, tilt)
    figure = Figure(figsize=(11, 2.6), layout="constrained")
    axes = figure.subplots(1, 4, sharey=True)
    for line, plot in enumerate(axes):
        on = (lines.line == line) & one.used
        place = lines.place[on]
        for channel in one.channels:
            plot.plot(place, predicted[on, channel], color=COLORS[channel], lw=1.4)
            plot.plot(place, seen[on, channel], ".", color=COLORS[channel], ms=4)
        plot.set_title(LINES[line], fontsize=9)
        plot.set_xlabel("mm")
        plot.grid(alpha=0.25)
    axes[0].set_ylabel("counts")
    axes[0].set_ylim(bottom=0)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=130)
    return stream.getvalue()
