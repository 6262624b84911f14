"""Figures 5.1 and 5.2: the metric at every site and bend, and the facets' colors there.

Maps are drawn as one looks at the skin from outside: across to the right, the tip at the top. The
camera looks from within and records the mirror image. Every figure is a plain matplotlib
``Figure`` on the Agg canvas, without pyplot's global state and without a display.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from render.arrays import Array
from render.geometry.layout import flat_sites, pyramid
from render.scene.schema import Scene

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


def metric_strip(scene: Scene, metric: Array, low: float, high: float) -> Figure:
    """Draw M of eq. (4.6) ``(bend, site)`` as one heat map per bend (Fig. 5.1), scale low..high.

    The scale is given, not taken from the data, so that all designs share it.
    """
    rows, columns = scene.sites.rows, scene.sites.columns
    left, right, bottom, top = _frame(scene)
    with _strip(scene) as (figure, panels):
        for axes, values in zip(panels, metric, strict=True):
            grid = values.reshape(rows, columns)
            axes.imshow(
                grid,
                origin="lower",
                extent=(left, right, bottom, top),
                cmap="viridis",
                vmin=low,
                vmax=high,
            )
            for (x, y), value in zip(flat_sites(scene)[:, :2], values, strict=True):
                dark = (value - low) < 0.62 * (high - low)
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
    """Draw the colors of all facets ``(bend, site, facet, 3)`` in counts, per bend (Fig. 5.2).

    Pyramids are drawn larger than life so that their facets can be told apart; where they are on
    the pad is true.
    """
    grow = 0.46 * scene.sites.spacing / scene.indenter.radius
    outlines = (flat_sites(scene)[:, None, None] + grow * pyramid(scene))[..., :2]
    left, right, bottom, top = _frame(scene)
    with _strip(scene) as (figure, panels):
        for axes, values in zip(panels, counts, strict=True):
            colors = encode_srgb(values.reshape(-1, 3) / 255) / 255
            polygons = list(outlines.reshape(-1, 3, 2))
            # Edges in the same color close the seams that antialiasing leaves between facets.
            axes.add_collection(
                PolyCollection(polygons, facecolors=colors, edgecolors=colors, linewidths=0.2)
            )
            axes.set(xlim=(left, right), ylim=(bottom, top), facecolor="#101114")
            axes.set_aspect("equal")
    return figure


@contextmanager
def _strip(scene: Scene) -> Iterator[tuple[Figure, list[Axes]]]:
    """Open one panel per bend, side by side and titled, in the shape of the field of sites."""
    left, right, bottom, top = _frame(scene)
    tall = min((top - bottom) / (right - left), 2.5)
    bends = scene.bending.angles
    with drawing(PANEL * len(bends), PANEL * tall + 0.22) as figure:
        panels = list(figure.subplots(1, len(bends), squeeze=False)[0])
        for axes, bend in zip(panels, bends, strict=True):
            axes.set_title(f"bend {np.degrees(bend):g}°")
            axes.set(xticks=[], yticks=[])
        yield figure, panels


def _frame(scene: Scene) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top (mm) of the field: half a spacing around the sites."""
    sites, half = flat_sites(scene)[:, :2], scene.sites.spacing / 2
    (left, bottom), (right, top) = sites.min(axis=0) - half, sites.max(axis=0) + half
    return left, right, bottom, top
