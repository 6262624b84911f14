"""The speed-accuracy plot: seconds per design against the error of facet colors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from optimize.report import drawing, png_bytes

if TYPE_CHECKING:
    from optimize.frontier.frontier import Frontier

GROUPS = {
    "preview": "#c46a1b",
    "converged": "#e0a04b",
    "checker": "#1f6fb2",
    "surrogate": "#1f6fb2",
    "transport": "#5b616b",
    "bidirectional": "#2b8a57",
    "PSSMLT": "#7aa83a",
    "volpath": "#a33a5a",
}
"""Color by the first word of a level's name."""


def draw_levels(axes: Axes, rows: Sequence[tuple[str, float, float, float]]) -> None:
    """Draw a numbered dot per level, both axes logarithmic, with a line to the 95th percentile.

    The rows are ``(level, seconds, median, p95)``, errors as fractions; they are numbered from 1.
    """
    for number, (level, seconds, median, p95) in enumerate(rows, start=1):
        color = GROUPS.get(level.replace(",", " ").replace(".", " ").split()[0], "black")
        axes.plot([seconds, seconds], [100 * median, 100 * p95], "-", color=color, lw=0.8)
        label, at = f"{number}  {level}", (seconds, 100 * median)
        axes.plot([seconds], [100 * median], "o", color=color, markersize=6, label=label)
        axes.annotate(str(number), at, xytext=(0, -12), textcoords="offset points", ha="center")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(60 * min(row[2] for row in rows), 140 * max(row[3] for row in rows))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_formatter(NullFormatter())
    axes.grid(which="major", lw=0.4, color="#d7dade")
    axes.set_xlabel("seconds per design (all bends)")
    axes.set_ylabel("error of facet colors, %\nmedian (dot) to 95th percentile")


def frontier_png(frontier: Frontier) -> bytes:
    """Return the plot as PNG, with the reference's own noise as a line."""
    with drawing(8.4, 4.2) as figure:
        axes = figure.add_subplot()
        rows = sorted(frontier.rows, key=lambda row: row.seconds_per_design)
        draw_levels(
            axes, [(r.level, r.seconds_per_design, r.facet_median, r.facet_p95) for r in rows]
        )
        noise = 100 * frontier.noise.facet_median
        axes.axhline(noise, color="#8a8f98", lw=0.8, ls="--", label="noise of the reference")
        axes.set_ylim(bottom=min(0.6 * noise, axes.get_ylim()[0]))
        plan, name = frontier.plan, frontier.reference.designs.scene.name
        axes.set_title(
            f"{name}: {plan.designs} random held-out designs against the reference, "
            f"{plan.samples} samples per cell",
            loc="left",
        )
        figure.legend(*axes.get_legend_handles_labels(), loc="outside right center", frameon=False)
        return png_bytes(figure, dpi=150)
