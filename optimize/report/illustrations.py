"""The pictures of a report: schemes of designs, maps of the metric, facets, the search's progress.

Maps are drawn as one looks at the skin from outside: across to the right, the tip at the top. The
camera looks from within and records the mirror image. Every figure is a plain matplotlib
``Figure`` on the Agg canvas, without pyplot's global state and without a display.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from optimize.design import Design, ScoreSettings
from optimize.search import SearchStep
from render.arrays import Array
from render.geometry import (
    bolt,
    counted_sites,
    declared_sites,
    flat_fiber_poses,
    flat_sites,
    in_state,
    pyramid,
)
from render.scene import OFF, Scene
from render.sensor_drawing import sensor_svg

PANEL = 1.75  # inches: a panel stays readable when three of them share the width of a phone
STYLE: Any = {
    "font.size": 9.0,
    "font.family": "DejaVu Sans",
    "axes.titlesize": 9.0,
    "axes.linewidth": 0.6,
    "axes.edgecolor": "#8a8f98",
    "text.color": "#1c1f24",
    "axes.labelcolor": "#1c1f24",
    "xtick.color": "#5b616b",
    "ytick.color": "#5b616b",
    "figure.facecolor": "white",
}

# What each stage of the search is called and drawn with.
STAGES = {
    "start": ("start", "#1c1f24"),
    "grouped": ("colors in pairs", "#93b4f5"),
    "coarsely grouped": ("colors in groups", "#93b4f5"),
    "quick": ("colors, 2-opt", "#2f5fd0"),
    "exact": ("colors, all", "#2f5fd0"),
    "tied": ("directions, tied", "#e0a458"),
    "free": ("directions, free", "#b45309"),
    "power": ("LED powers", "#7c3aed"),
    "reader": ("by the reader", "#0f766e"),
}


def encode_srgb(linear: Array) -> NDArray[np.uint8]:
    """Return 8-bit sRGB (IEC 61966-2-1) of linear values ``(..., 3)``, 1 being full white."""
    x = np.clip(linear, 0.0, 1.0)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.asarray(np.round(255 * encoded), dtype=np.uint8)


@contextmanager
def drawing(width: float, height: float) -> Iterator[Figure]:
    """Open a figure of ``width`` x ``height`` inches in the report's style."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        yield figure


def png_bytes(figure: Figure, dpi: int = 192) -> bytes:
    """Return the figure as a PNG without timestamps, so that equal content is equal bytes."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi, metadata={"Software": "tactilux"})
    return stream.getvalue()


def picture_png(linear: Array) -> bytes:
    """Return a linear image ``(row, column, 3)``, 1 being full white, as sRGB PNG."""
    from matplotlib.image import imsave

    stream = io.BytesIO()
    imsave(stream, encode_srgb(linear), format="png", metadata={"Software": "tactilux"})
    return stream.getvalue()


class Illustrated(Protocol):
    """A design that a report draws: its key, its lights, its map of M and its facet colors."""

    @property
    def key(self) -> str:
        """Names its pictures."""

    @property
    def design(self) -> Design:
        """Directions and LED powers."""

    @property
    def metric(self) -> Array:
        """M of eq. (4.6), ``(bend, site)``."""

    @property
    def counts(self) -> Array:
        """Facet colors ``(bend, site, facet, channel)``."""

    @property
    def error_map(self) -> Array | None:
        """Degrees by which the sensor reader misses normals, ``(bend, site)``, where known."""


class Seen(Protocol):
    """A design that the camera is shown under: its key, its lights and its exposure."""

    @property
    def key(self) -> str:
        """Names its pictures."""

    @property
    def design(self) -> Design:
        """Directions and LED powers."""

    @property
    def settings(self) -> ScoreSettings:
        """The camera that sees it."""


def design_pictures(scene: Scene, entries: Sequence[Illustrated]) -> Iterator[tuple[str, bytes]]:
    """Yield ``scheme-<key>`` (SVG), ``metric-<key>`` (Fig. 5.1) and ``facets-<key>`` (Fig. 5.2).

    Where readers' errors are known ``degrees-<key>`` too. All maps of a kind share one scale.
    """
    maps = np.stack([entry.metric for entry in entries])
    errors = [entry.error_map for entry in entries if entry.error_map is not None]
    for entry in entries:
        names = entry.design.color_names
        inks = [None if color == OFF else scene.palette.ink(color) for color in names]
        scheme = sensor_svg(scene, entry.design.phi, inks, section=False)
        yield f"scheme-{entry.key}", scheme.encode()
        strip = site_map(scene, entry.metric, float(maps.min()), float(maps.max()))
        yield f"metric-{entry.key}", png_bytes(strip)
        if entry.error_map is not None:
            ends = float(np.min(errors)), float(np.max(errors))
            yield (
                f"degrees-{entry.key}",
                png_bytes(site_map(scene, entry.error_map, *ends, less_is_better=True)),
            )
        yield f"facets-{entry.key}", png_bytes(facet_strip(scene, entry.counts))


def site_map(
    scene: Scene, shown: Array, low: float, high: float, *, less_is_better: bool = False
) -> Figure:
    """Draw values ``(bend, site)`` as one heat map per bend (Fig. 5.1), scale low..high.

    The scale is given, not taken from the data, so that all designs share it. What is better is
    brighter.
    """
    rows, columns = scene.sites.rows, scene.sites.columns
    left, right, bottom, top = _frame(scene)
    with _strip(scene) as (figure, panels):
        for axes, values in zip(panels, shown, strict=True):
            grid = np.full(rows * columns, np.nan)
            grid[counted_sites(scene)] = values
            axes.imshow(
                grid.reshape(rows, columns),
                origin="lower",
                extent=(left, right, bottom, top),
                cmap="viridis_r" if less_is_better else "viridis",
                vmin=low,
                vmax=high,
            )
            for (x, y), value in zip(flat_sites(scene)[:, :2], values, strict=True):
                bright = high - value if less_is_better else value - low
                dark = bright < 0.62 * (high - low)
                axes.text(
                    x,
                    y,
                    f"{value:.0f}" if high >= 100 else f"{value:.1f}",
                    ha="center",
                    va="center",
                    color="white" if dark else "#1c1f24",
                )
    return figure


def facet_strip(scene: Scene, counts: Array) -> Figure:
    """Draw the colors of facets ``(bend, site, facet, channel)`` in counts, per bend (Fig. 5.2).

    Shots are panels of their own, those of a bend side by side.

    Pyramids are drawn larger than life so that their facets can be told apart; where they are on
    the pad is true.
    """
    grow = 0.46 * scene.sites.spacing / scene.indenter.radius
    outlines = (flat_sites(scene)[:, None, None] + grow * pyramid(scene))[..., :2]
    left, right, bottom, top = _frame(scene)
    shots = scene.palette.shots
    shown = [part for values in counts for part in np.split(values, shots, axis=-1)]
    with _strip(scene, shots) as (figure, panels):
        for axes, values in zip(panels, shown, strict=True):
            linear = values.reshape(-1, values.shape[-1]) / 255
            colors = encode_srgb(linear @ scene.palette.display) / 255
            polygons = list(outlines.reshape(-1, 3, 2))
            # Edges in the same color close the seams that antialiasing leaves between facets.
            axes.add_collection(
                PolyCollection(polygons, facecolors=colors, edgecolors=colors, linewidths=0.2)
            )
            axes.set(xlim=(left, right), ylim=(bottom, top), facecolor="#101114")
            axes.set_aspect("equal")
    return figure


@contextmanager
def _strip(scene: Scene, shots: int = 1) -> Iterator[tuple[Figure, list[Axes]]]:
    """Open one panel per bend and shot, side by side and titled, in the shape of the field."""
    left, right, bottom, top = _frame(scene)
    tall = min((top - bottom) / (right - left), 2.5)
    bends = list(scene.state_titles)
    if shots > 1:
        numbers = range(1, shots + 1)
        bends = [f"{bend}{', ' * bool(bend)}shot {shot}" for bend in bends for shot in numbers]
    with drawing(PANEL * len(bends), PANEL * tall + 0.22) as figure:
        panels = list(figure.subplots(1, len(bends), squeeze=False)[0])
        for axes, bend in zip(panels, bends, strict=True):
            axes.set_title(bend)
            axes.set(xticks=[], yticks=[])
        yield figure, panels


def _frame(scene: Scene) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top (mm) of the field: half a spacing around the sites."""
    sites, half = declared_sites(scene)[:, :2], scene.sites.spacing / 2
    (left, bottom), (right, top) = sites.min(axis=0) - half, sites.max(axis=0) + half
    return left, right, bottom, top


def beam_length(scene: Scene) -> float:
    """Return how long (mm) beams are drawn: so short that those of neighbors never cross."""
    ends = flat_fiber_poses(scene).position
    apart = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    return float(np.clip(0.49 * apart.min(initial=8.0), 0.8, 3.4))


def convergence(steps: Sequence[SearchStep]) -> Figure:
    """Draw the best score after every stage of the search, over the seconds that it took."""
    with drawing(6.4, 2.5) as figure:
        axes = figure.subplots()
        seconds = [step.seconds for step in steps]
        scores = [step.score for step in steps]
        axes.step(seconds, scores, where="post", color="#b6bbc4", lw=1.2, zorder=1)
        for stage, (label, tone) in STAGES.items():
            at = [(step.seconds, step.score) for step in steps if step.stage == stage]
            if at:
                axes.plot(*zip(*at, strict=True), "o", ms=5, color=tone, label=label)
        axes.set(xlabel="seconds", ylabel="best score S")
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, loc="lower right")
    return figure


PREVIEW_WIDTH = 240  # pixels; the height follows from the camera


def camera_pictures(scene: Scene, stages: Sequence[Seen]) -> Iterator[tuple[str, bytes]]:
    """Yield ``preview-<key>-<bend index>``: what the camera sees, drawn by the preview.

    A pyramid is pressed in at every site. Brightness is exposed as the scene's camera is, so that
    pictures can be compared.

    Raises:
        GraphicsError: nothing here can draw.
    """
    from render.preview import Preview

    height = round(PREVIEW_WIDTH * scene.camera.rows / scene.camera.columns)
    with Preview(scene) as preview:
        for stage in stages:
            for index, bend in enumerate(scene.state_axis):
                radiance = preview.picture(
                    stage.design.phi, stage.design.power, bend, PREVIEW_WIDTH, height
                )
                counts = np.asarray(radiance, dtype=np.float64) * stage.settings.exposure
                linear = scene.palette.shown(counts) / stage.settings.conventions.count_max
                yield f"preview-{stage.key}-{index}", picture_png(linear)


BOLT_ROWS = 450  # pixels of the camera's view, before it is cut to the pad


def bolt_pictures(
    scene: Scene, designs: Sequence[Design], settings: ScoreSettings
) -> list[list[bytes]]:
    """Return Fig. 5.3: for every design a PNG per bend, the tip up as in all pictures.

    Drawn by the preview at the scene's one exposure, and all cut to the same frame.

    Raises:
        SceneError: the bolt does not fit into the pad.
        GraphicsError: nothing here can draw.
    """
    from render.preview import Preview

    width = round(BOLT_ROWS * scene.camera.columns / scene.camera.rows)
    sensors, parts = [scene], []
    if scene.states is not None:
        sensors = [in_state(scene, state)[0] for state in scene.state_axis]
    for sensor in sensors:
        with Preview(sensor, imprint=bolt(sensor)) as preview:
            parts.append(
                [
                    [
                        preview.picture(d.phi, d.power, bend, width, BOLT_ROWS)
                        for bend in sensor.state_axis
                    ]
                    for d in designs
                ]
            )
    drawn = np.concatenate(parts, axis=1, dtype=np.float64)
    lit = np.any(drawn, axis=(0, 1, 4))
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    frame = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    bright = settings.exposure / settings.conventions.count_max
    show = scene.palette.shown
    return [[picture_png(show(bright * seen[frame])) for seen in pictures] for pictures in drawn]
