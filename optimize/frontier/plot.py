"""The speed-accuracy plot: seconds per design against the error of facet colours."""

from __future__ import annotations

import io

from optimize.frontier.frontier import Frontier
from optimize.heatmaps import drawing

GROUPS = {
    "preview": "#c46a1b",
    "checker": "#1f6fb2",
    "transport": "#5b616b",
    "PSSMLT": "#2b8a57",
    "volpath": "#a33a5a",
}
"""Colour by the first word of a level's name."""


def frontier_png(frontier: Frontier) -> bytes:
    """Return the plot as PNG: one dot per level, the reference's own noise as a line."""
    with drawing(7.2, 4.4) as figure:
        axes = figure.add_subplot()
        rows = frontier.rows
        for row in rows:
            word = row.level.replace(",", " ").replace(".", " ").split()[0]
            x, y = row.seconds_per_design, 100 * row.facet_error_median
            axes.plot([x], [y], "o", color=GROUPS.get(word, "black"), markersize=6)
            axes.plot([x, x], [y, 100 * row.facet_error_p95], "-", color=GROUPS.get(word), lw=0.8)
        noise = 100 * frontier.noise.facet_error_median
        axes.axhline(noise, color="#8a8f98", lw=0.8, ls="--")
        axes.set_xscale("log")
        axes.set_yscale("log")
        low = min(row.seconds_per_design for row in rows)
        high = max(row.seconds_per_design for row in rows)
        axes.set_xlim(low / 3, high * 60)
        bottom = min(noise, *(100 * row.facet_error_median for row in rows))
        axes.set_ylim(0.7 * bottom, 1.6 * max(100 * row.facet_error_p95 for row in rows))
        axes.text(high * 50, 1.03 * noise, "noise of the reference", ha="right", va="bottom",
                  color="#5b616b")  # fmt: skip
        _label(axes, frontier)
        axes.set_xlabel("seconds per design (all bends)")
        axes.set_ylabel("error of facet colours, %: median (dot) to 95th percentile")
        axes.set_title(
            f"{frontier.scene.name}: {rows[0].designs} random held-out designs against PSSMLT with "
            f"{frontier.reference.mutations} mutations per cell"
        )
        axes.grid(which="major", lw=0.4, color="#d7dade")
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=150)
        return stream.getvalue()


def _label(axes: object, frontier: Frontier) -> None:
    """Write the names to the right of their dots, moved apart where dots crowd."""
    import math

    placed: list[tuple[float, float]] = []
    for row in sorted(frontier.rows, key=lambda row: row.facet_error_median):
        x, y = math.log10(row.seconds_per_design), math.log10(100 * row.facet_error_median)
        while any(abs(x - px) < 1.6 and abs(y - py) < 0.075 for px, py in placed):
            y += 0.02
        placed.append((x, y))
        axes.annotate(  # type: ignore[attr-defined]
            row.level,
            (row.seconds_per_design, 100 * row.facet_error_median),
            xytext=(10 ** (x + 0.12), 10**y),
            va="center",
            fontsize=8,
        )
