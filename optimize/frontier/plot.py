"""The speed-accuracy plot: seconds per design against the error of facet colors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from optimize.report import drawing, png_bytes
from render.levels import CONVERGED, FEW_PATHS, FEW_RENDERS, SURROGATE, TABLE, level_name

if TYPE_CHECKING:
    from optimize.frontier.frontier import Frontier
    from optimize.frontier.survey import Survey

GROUPS = {
    "preview": "#c46a1b",
    level_name(SURROGATE, FEW_PATHS): "#a8407a",
    level_name(SURROGATE, CONVERGED): "#e0a04b",
    level_name(SURROGATE, FEW_RENDERS): "#7b5bb0",
    level_name(SURROGATE, TABLE): "#5b616b",
    "checker": "#1f6fb2",
    "surrogate": "#1f6fb2",
    "1/32": "#8cc9a6",
    "1/8": "#2b8a57",
    "bidirectional": "#2b8a57",
    "PSSMLT": "#7aa83a",
    "volpath": "#a33a5a",
}
"""Color by a row's name, or its first word."""


FLOOR = 5e-4
"""Smallest error that is drawn: what noise hides lies there."""
BOUNDS = 0.87, 0.93
"""What the coverage of 90 % intervals should lie between."""


def draw_levels(axes: Axes, rows: Sequence[tuple[str, float, float, float]]) -> None:
    """Draw a numbered dot per row, both axes logarithmic, with a line to the 95th percentile.

    The rows are ``(name, seconds, median, p95)``, errors as fractions; they are numbered from 1.
    """
    for number, (name, seconds, median, p95) in enumerate(rows, start=1):
        color = _color(name)
        axes.plot([seconds, seconds], [100 * median, 100 * p95], "-", color=color, lw=0.8)
        label, at = f"{number}  {name}", (seconds, 100 * median)
        axes.plot([seconds], [100 * median], "o", color=color, markersize=6, label=label)
        axes.annotate(str(number), at, xytext=(0, -12), textcoords="offset points", ha="center")
    axes.set_xscale("log")
    axes.set_yscale("log")
    least = max(min(row[2] for row in rows), FLOOR)
    axes.set_ylim(60 * least, 140 * max(row[3] for row in rows))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_formatter(NullFormatter())
    axes.grid(which="major", lw=0.4, color="#d7dade")
    axes.set_xlabel("seconds per design (all shapes of its skin)")
    axes.set_ylabel("error of facet colors, %\nmedian (dot) to 95th percentile")


def _color(name: str) -> str:
    if name in GROUPS:
        return GROUPS[name]
    return GROUPS.get(name.replace(",", " ").replace(".", " ").split()[0], "black")


def frontier_png(frontier: Frontier) -> bytes:
    """Return the plot as PNG, with the reference's own noise as a line."""
    with drawing(8.4, 4.2) as figure:
        axes = figure.add_subplot()
        rows = sorted(frontier.rows, key=lambda row: row.seconds_per_design)
        draw_levels(
            axes, [(r.name, r.seconds_per_design, r.facet_median, r.facet_p95) for r in rows]
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


def survey_png(survey: Survey) -> bytes:
    """Return the plot of many scenes as PNG: error against seconds, coverage, tau.

    A dot is a scene, a cross the median of a rung; errors are without the reference's noise.
    """
    rungs = survey.summary()
    with drawing(11.0, 4.6) as figure:
        error, held, ranks = figure.subplots(1, 3, width_ratios=[1.5, 1.0, 1.0])
        for place, rung in enumerate(rungs):
            color = _color(rung.rung)
            pairs = [
                (row, s.noise) for s in survey.scenes for row in s.rows if row.rung == rung.rung
            ]
            seconds = [row.setup_seconds + row.seconds_per_design for row, _ in pairs]
            errors = [100 * max(row.facet_median_true, FLOOR) for row, _ in pairs]
            error.plot(seconds, errors, "o", color=color, ms=4, alpha=0.6)
            middle = [rung.ready_seconds], [100 * max(rung.facet_median, FLOOR)]
            error.plot(*middle, "P", color=color, ms=10, mec="black", mew=0.6, label=rung.rung)
            covered = [row.interval.score for row, _ in pairs if row.interval is not None]
            held.plot(covered, [place] * len(covered), "o", color=color, ms=4, alpha=0.6)
            if rung.score_coverage is not None:
                held.plot([rung.score_coverage], [place], "P", color=color, ms=10, mec="black",
                          mew=0.6)  # fmt: skip
            taus = [row.kendall_tau for row, _ in pairs]
            ranks.plot(taus, [place] * len(taus), "o", color=color, ms=4, alpha=0.6)
            ranks.plot([rung.kendall_tau], [place], "P", color=color, ms=10, mec="black", mew=0.6)
            ranks.plot([rung.noise_tau], [place], "|", color="black", ms=14)
        error.set_xscale("log")
        error.set_yscale("log")
        error.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        error.yaxis.set_major_formatter("{x:g}")
        error.yaxis.set_minor_formatter(NullFormatter())
        error.set_xlabel("seconds until the first design")
        error.set_ylabel("median error of facet colors without noise, %")
        held.axvspan(*BOUNDS, color="#dfe9df")
        held.set_xlabel("scores that 90 % intervals held")
        ranks.set_xlabel("Kendall's tau (line: what noise leaves)")
        for axes in (held, ranks):
            axes.set_yticks(
                range(len(rungs)), [rung.rung for rung in rungs] if axes is held else []
            )
            axes.invert_yaxis()
        for axes in (error, held, ranks):
            axes.grid(which="major", lw=0.4, color="#d7dade")
        error.set_title(f"{len(survey.scenes)} scenes; a dot is a scene", loc="left")
        return png_bytes(figure, dpi=150)
