"""The figures of a report: convergence, surrogate against renders, speed and accuracy, the bolt."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from optimize.design import Array
from optimize.frontier.plot import draw_levels
from optimize.overnight.result import ConvergencePoint, OvernightResult
from optimize.report import INK, drawing, facet_strip, metric_strip, picture_png, png_bytes, scheme
from render.geometry import bolt
from render.preview import Preview

WIDTH, HEIGHT = 4.6, 3.4  # inches: text stays readable at the width of a phone
SOFT = "#8a8f98"
TIMED = ("seconds_per_design", "facet_error_median", "facet_error_p95")
"""What of the trade between speed and accuracy is drawn."""
ROLES = {
    "baseline": ("baseline", "#1c1f24"),
    "incumbent": ("best so far, again", "#a78bfa"),
    "best": ("surrogate's best", "#b45309"),
    "uncertain": ("most uncertain", "#2f5fd0"),
    "random": ("random", "#1e9e4a"),
    "colors": ("colors", "#0e9aa7"),
    "thesis": ("thesis-style", "#c2410c"),
    "runner-up": ("runner-up", "#93b4f5"),
    "winner": ("winner", "#7c3aed"),
}
OTHER = ("other", "#9aa0aa")


def convergence(result: OvernightResult) -> Figure:
    """Draw every rendered score over the render time, with 95 % intervals and predictions."""
    steps = result.steps
    seconds = np.array([step.render_seconds for step in steps])
    unit, name = (3600.0, "hours") if seconds.max() > 7200 else (60.0, "minutes")
    with drawing(WIDTH, HEIGHT) as figure:
        axes = figure.subplots()
        at = _side_by_side(seconds / unit)
        for role in dict.fromkeys(step.role for step in steps):
            label, tone = ROLES.get(role, OTHER)
            mine = [i for i, step in enumerate(steps) if step.role == role]
            axes.errorbar(
                at[mine],
                [steps[i].score for i in mine],
                [result.interval_factor * steps[i].se for i in mine],
                fmt="o",
                ms=4.5,
                lw=1.0,
                capsize=2,
                color=tone,
                label=label,
            )
            axes.plot(at[mine], [steps[i].predicted for i in mine], "x", ms=5, mew=1.0, color=tone)
        axes.plot([], [], "x", ms=5, mew=1.0, color=SOFT, label="predicted")
        moments, best = _best_by_then(steps)
        axes.step(moments / unit, best, where="post", color="#b6bbc4", lw=1.2, zorder=1)
        for entry in (result.finalists[0], result.finalist(result.winner)):
            half = result.interval_factor * entry.se
            band = axes.axhspan(entry.score - half, entry.score + half, lw=0, zorder=0)
            band.set_facecolor("#e6e8ec" if entry is result.finalists[0] else "#fdebd0")
        axes.set(xlabel=f"{name} of rendering", ylabel="score S")
        axes.spines[["top", "right"]].set_visible(False)
        figure.legend(
            *axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False
        )
    return figure


def score_scatter(result: OvernightResult) -> Figure:
    """Draw predicted against rendered scores of all designs that were rendered."""
    with drawing(WIDTH, HEIGHT) as figure:
        axes = figure.subplots()
        steps = result.steps
        if steps:
            axes.errorbar(
                [step.predicted for step in steps],
                [step.score for step in steps],
                [result.interval_factor * step.se for step in steps],
                fmt="o",
                ms=3.5,
                lw=0.8,
                color=SOFT,
                label="during the search",
            )
        axes.errorbar(
            [entry.predicted for entry in result.finalists],
            [entry.score for entry in result.finalists],
            [result.interval_factor * entry.se for entry in result.finalists],
            [entry.predicted_reach for entry in result.finalists],
            fmt="s",
            ms=5,
            lw=1.2,
            color="#b45309",
            label="finalists",
        )
        _identity(axes)
        axes.set(xlabel="score S, surrogate", ylabel="score S, rendered")
        axes.legend(frameon=False, loc="upper left")
    return figure


def color_scatter(result: OvernightResult) -> Figure:
    """Draw predicted against rendered facet colors of all finalists, and what is left over."""
    predicted = np.concatenate([e.predicted_counts.reshape(-1, 3) for e in result.finalists])
    rendered = np.concatenate([e.counts.reshape(-1, 3) for e in result.finalists])
    noise = np.concatenate([e.counts_se.reshape(-1, 3) for e in result.finalists])
    with drawing(WIDTH, HEIGHT) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1))
        for channel, name in enumerate(("red", "green", "blue")):
            x, y = predicted[:, channel], rendered[:, channel]
            look = {"ms": 2.0, "alpha": 0.35, "mew": 0, "color": INK[name]}
            upper.plot(x, y, "o", **look)
            upper.plot([], [], "o", ms=4, color=INK[name], label=name)
            lower.plot(x, x - y, "o", **look)
        _identity(upper)
        lower.axhline(0.0, color=SOFT, lw=0.8)
        edges = np.linspace(predicted.min(), predicted.max(), 9)
        middle, level = 0.5 * (edges[1:] + edges[:-1]), np.digitize(predicted, edges[1:-1])
        spread = [np.sqrt((noise[level == i] ** 2).mean()) for i in np.unique(level)]
        half_width = result.interval_factor * np.array(spread)
        lower.plot(middle[np.unique(level)], half_width, "-", color="#1c1f24", lw=0.9)
        lower.plot(middle[np.unique(level)], -half_width, "-", color="#1c1f24", lw=0.9)
        upper.set(ylabel="rendered counts")
        lower.set(xlabel="facet colors, surrogate (counts)", ylabel="difference")
        upper.legend(frameon=False, loc="upper left")
        for axes in (upper, lower):
            axes.spines[["top", "right"]].set_visible(False)
    return figure


def speed_accuracy(result: OvernightResult) -> Figure:
    """Draw the error of facet colors of every level over its seconds per design."""
    with drawing(WIDTH, HEIGHT) as figure:
        axes = figure.subplots()
        rows = [(str(row["level"]), *_drawn(row)) for row in timed_levels(result)]
        draw_levels(axes, rows)
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _drawn(row: dict[str, float | str | None]) -> tuple[float, float, float]:
    seconds, median, p95 = (float(row[key] or 0.0) for key in TIMED)
    return seconds, median, p95


def timed_levels(result: OvernightResult) -> list[dict[str, float | str | None]]:
    """Return the rows of the trade that can be drawn, from quick to slow."""
    rows = [dict(row) for row in result.trade if all(row.get(key) for key in TIMED)]
    return sorted(rows, key=lambda row: float(row["seconds_per_design"] or 0.0))


def _side_by_side(at: Array) -> Array:
    """Return positions at which points of equal ``at`` do not cover each other."""
    step = 0.015 * float(at.max())
    shifted = at.astype(np.float64)
    for value in np.unique(at):
        same = np.flatnonzero(at == value)
        shifted[same] += step * (np.arange(len(same)) - (len(same) - 1) / 2)
    return shifted


def _best_by_then(steps: tuple[ConvergencePoint, ...]) -> tuple[Array, Array]:
    """Return the seconds at which something was rendered, and the best score of those renders.

    Not the best of all so far: that would be the luckiest of the noisy ones at the beginning.
    """
    moments = np.unique([step.render_seconds for step in steps])
    scores = [max(s.score for s in steps if s.render_seconds == moment) for moment in moments]
    return moments, np.array(scores)


def _identity(axes: Axes) -> None:
    low = min(axes.get_xlim()[0], axes.get_ylim()[0])
    high = max(axes.get_xlim()[1], axes.get_ylim()[1])
    axes.plot([low, high], [low, high], "-", color=SOFT, lw=0.8, zorder=0)
    axes.spines[["top", "right"]].set_visible(False)


BOLT_ROWS = 450  # pixels of the camera's view, before it is cut to the pad


def report_pictures(result: OvernightResult) -> Iterator[tuple[str, bytes]]:
    """Yield ``(name, PNG)``.

    ``scheme-<key>``, ``metric-<key>`` (Fig. 5.1) and ``facets-<key>`` (Fig. 5.2) of all finalists,
    ``convergence``, ``scores``, ``colors`` and, where the night has what they show, ``trade``.
    """
    scene = result.scene
    maps = np.stack([entry.metric for entry in result.finalists])
    for entry in result.finalists:
        yield f"scheme-{entry.key}", png_bytes(scheme(scene, entry.design))
        strip = metric_strip(scene, entry.metric, float(maps.min()), float(maps.max()))
        yield f"metric-{entry.key}", png_bytes(strip)
        yield f"facets-{entry.key}", png_bytes(facet_strip(scene, entry.counts))
    if result.steps:
        yield "convergence", png_bytes(convergence(result))
    yield "scores", png_bytes(score_scatter(result))
    yield "colors", png_bytes(color_scatter(result))
    if timed_levels(result):
        yield "trade", png_bytes(speed_accuracy(result))


def bolt_pictures(result: OvernightResult) -> dict[tuple[str, int], bytes]:
    """Return Fig. 5.3: PNGs by finalist (baseline, winner) and bend index, the tip to the left.

    Drawn by the preview (level 0) at the scene's one exposure, and all cut to the same frame.

    Raises:
        SceneError: the bolt does not fit into the pad.
        GraphicsError: nothing here can draw.
    """
    scene = result.scene
    columns = round(BOLT_ROWS * scene.camera.columns / scene.camera.rows)
    drawn: dict[tuple[str, int], Array] = {}
    with Preview(scene, imprint=bolt(scene)) as preview:
        for index, bend in enumerate(scene.bending.angles):
            for key in dict.fromkeys(("baseline", result.winner)):
                design = result.finalist(key).design
                seen = preview.picture(design.phi, design.power, bend, columns, BOLT_ROWS)
                drawn[key, index] = np.asarray(seen, dtype=np.float64)
    lit = np.any([picture.any(axis=-1) for picture in drawn.values()], axis=0)
    rows, columns_lit = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    frame = (
        slice(rows.min(), rows.max() + 1),
        slice(columns_lit.min(), columns_lit.max() + 1),
    )
    bright = result.settings.exposure / result.settings.conventions.count_max
    return {name: picture_png(np.rot90(seen[frame]) * bright) for name, seen in drawn.items()}
