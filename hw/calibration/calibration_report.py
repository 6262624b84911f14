"""The calibration's report: one HTML file with measured and simulated curves overlaid."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from importlib import resources

import jinja2
import numpy as np

from hw.calibration.confirm import Confirmation
from hw.calibration.fit import Calibration
from hw.calibration.material import NAMES, UNITS, Material
from hw.calibration.measurement import Measurement
from hw.calibration.reference_lines import NAMES as LINES
from hw.calibration.reference_lines import ReferenceLines
from hw.camera.linearity import Linearity
from optimize.scoring import normal_factor
from render.arrays import Array
from render.scene.schema import Scene

SHOWN = 6
"""Photographs whose curves are drawn, spread evenly over all."""
COLORS = ("#d43d3d", "#1f9d55", "#2f66d0")
TITLES = {
    "reduced_scattering": "reduced scattering",
    "absorption": "absorption",
    "sigma_v": "beam width sigma_v",
    "roughness": "roughness alpha",
}


@dataclass(frozen=True, eq=False)
class ReportContent:
    """What the report tells."""

    scene: Scene
    found: Calibration
    measurements: list[Measurement]
    lines: ReferenceLines
    bends: Array
    linearity: Linearity
    confirmation: Confirmation | None
    date: str


def render_report(content: ReportContent) -> str:
    """Return the HTML text; everything is inside the one file."""
    template = resources.files("hw") / "templates" / "calibration.html.j2"
    environment = jinja2.Environment(
        loader=jinja2.BaseLoader(), autoescape=True, undefined=jinja2.StrictUndefined
    )
    page = environment.from_string(template.read_text(encoding="utf-8"))
    chosen = np.unique(
        np.linspace(0, len(content.measurements) - 1, SHOWN).round().astype(int)
    ).tolist()
    return page.render(
        name=content.scene.name,
        date=content.date,
        count=len(content.measurements),
        rows=value_rows(content.scene, content.found),
        powers=[
            {
                "fiber": fiber,
                "power": f"{content.found.power[fiber]:.3f}",
                "se": f"{normal_factor() * se:.3f}",
            }
            for fiber, se in zip(
                np.nonzero(np.isfinite(content.found.power))[0].tolist(),
                content.found.intervals.power
                * content.found.power[np.isfinite(content.found.power)],
                strict=True,
            )
        ],
        gains=[f"{gain:.4g}" for gain in content.found.gain if np.isfinite(gain)],
        tilt=", ".join(f"{np.degrees(angle):+.2f}" for angle in content.found.tilt),
        vignetting=f"{100 * content.found.vignetting:.0f}",
        chi=f"{content.found.chi:.2f}",
        linear=f"{100 * content.linearity.residual:.2f}",
        related=[
            f"{TITLES[a]} and {TITLES[b]} (correlation {value:+.2f})"
            for a, b, value in content.found.intervals.related()
        ],
        confirmation=content.confirmation,
        figures=[
            {"title": _title(content, index), "plot": _curves(content, index)} for index in chosen
        ],
    )


def value_rows(scene: Scene, found: Calibration) -> list[dict[str, str]]:
    """Return the fitted values as text: value, interval, the scene's before, error by source."""
    before, values = Material.of(scene).array(), found.material.array()
    ranges = found.intervals.of(values)
    rows = []
    for index, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
        factor = 180 / np.pi if unit == "deg" else 1.0
        low, high = (factor * end for end in ranges[index])
        rows.append(
            {
                "title": TITLES[name],
                "value": f"{factor * values[index]:.4g} {unit}".rstrip(),
                "interval": f"{low:.4g} to {high:.4g}",
                "before": f"{factor * before[index]:.4g}",
                "sources": ", ".join(
                    f"{source} {factor * part[index]:.2g}"
                    for source, part in found.intervals.parts.items()
                ),
            }
        )
    return rows


def _title(content: ReportContent, index: int) -> str:
    one = content.measurements[index]
    return f"Fiber {one.fiber}, bend {np.degrees(content.bends[one.bend]):.0f} deg"


def _curves(content: ReportContent, index: int) -> str:
    """Draw the four lines of one photograph: dots measured, lines simulated."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib.figure import Figure

    one, wanted = content.measurements[index], content.found.predicted[index]
    seen = one.counts + np.einsum("tpc,t->pc", one.tilt_slope, content.found.tilt)
    figure = Figure(figsize=(11, 2.6), layout="constrained")
    axes = figure.subplots(1, 4, sharey=True)
    for line, plot in enumerate(axes):
        on = (content.lines.line == line) & one.used
        place = content.lines.place[on]
        for channel in one.channels:
            plot.plot(place, wanted[on, channel], color=COLORS[channel], lw=1.4)
            plot.plot(place, seen[on, channel], ".", color=COLORS[channel], ms=4)
        plot.set_title(LINES[line], fontsize=9)
        plot.set_xlabel("mm")
        plot.grid(alpha=0.25)
    axes[0].set_ylabel("counts")
    axes[0].set_ylim(bottom=0)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=130)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()
