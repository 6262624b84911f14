"""The speed-accuracy plot: seconds per design against the error of facet colors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from optimize.report import drawing, png_bytes

if TYPE_CHECKING:
    from optimize.frontier.frontier import Frontier

GROUPS = {
    "preview": "#c46a1b",
    "checker": "#1f6fb2",
    "surrogate": "#1f6fb2",
    "transport": "#5b616b",
    "bidirectional": "#2b8a57",
    "PSSMLT": "#7aa83a",
    "volpath": "#a33a5a",
}
"""Color by the first word of a level's name."""


def draw_levels(axes: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    """Draw a numbered dot per level, both axes logarithmic, with a line to the 95th percentile.

    The rows are those of the frontier's JSON; they are numbered from 1 in their order.
    """
    for number, row in enumerate(rows, start=1):
        first = str(row["level"]).replace(",", " ").replace(".", " ").split()[0]
        color = GROUPS.get(first, "black")
        x, y = row["seconds_per_design"], 100 * row["facet_error_median"]
        axes.plot([x, x], [y, 100 * row["facet_error_p95"]], "-", color=color, lw=0.8)
        axes.plot([x], [y], "o", color=color, markersize=6, label=f"{number}  {row['level']}")
        axes.annotate(str(number), (x, y), xytext=(0, -12), textcoords="offset points", ha="center")
    axes.set_xscale("log")
    axes.set_yscale("log")
    low = 100 * min(row["facet_error_median"] for row in rows)
    axes.set_ylim(0.6 * low, 1.4 * max(100 * row["facet_error_p95"] for row in rows))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_formatter(NullFormatter())
    axes.grid(which="major", lw=0.4, color="#d7dade")


def frontier_png(frontier: Frontier) -> bytes:
    """Return the plot as PNG: a numbered dot per level, the reference's own noise as a line."""
    with drawing(8.4, 4.2) as figure:
        axes = figure.add_subplot()
        rows = sorted(frontier.rows, key=lambda row: row.seconds_per_design)
        draw_levels(axes, [asdict(row) for row in rows])
        noise = 100 * frontier.noise.facet_error_median
        axes.axhline(noise, color="#8a8f98", lw=0.8, ls="--", label="noise of the reference")
        axes.set_ylim(bottom=min(0.6 * noise, axes.get_ylim()[0]))
        axes.set_xlabel("seconds per design (all bends)")
        axes.set_ylabel("error of facet colors, %\nmedian (dot) to 95th percentile")
        axes.set_title(
            f"{frontier.scene.name}: {rows[0].designs} random held-out designs against the "
            f"reference, {frontier.reference.samples} samples per cell",
            loc="left",
        )
        figure.legend(*axes.get_legend_handles_labels(), loc="outside right center", frameon=False)
        return png_bytes(figure, dpi=150)
