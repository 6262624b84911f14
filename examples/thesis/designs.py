"""Figs. 5.1, 5.2 and 5.3 of the thesis: baseline, colors and optimized design of finger20.

The surrogate searches as `tactilux.explore` does; ``--samples`` renders the three designs as well,
and Fig. 5.1 then shows the renders. Pictures of contacts are drawn by the preview, the tip
up and left on the left, at the exposure of the scene.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.image import imread

import tactilux
from hw.camera.projection import pixels_of
from optimize.exploration import Exploration, Stage
from optimize.report import bolt_pictures, design_pictures, drawing, encode_srgb, png_bytes
from render.arrays import Array
from render.geometry import flat_sites
from render.metric import design_score, image_counts, site_metric

TITLES = {
    "baseline": "baseline",
    "colors": "after the color search",
    "optimized": "with directions",
}
PATCH = 1.1
"""mm, half the side of the patch around a contact."""
PATCH_PIXELS = 28
VIEW_ROWS = 800


@dataclass(frozen=True)
class Rated:
    """A stage of the search with M ``(bend, site)`` from one level, and its standard error or 0."""

    stage: Stage
    metric: Array
    se: float


@cache
def found() -> Exploration:
    """Return the search, made once."""
    return tactilux.explore(tactilux.load_scene("finger20"), objective="score")


def rated(samples: int, say: Callable[[str], None]) -> list[Rated]:
    """Return the stages on the surrogate, or on renders with so many ``samples`` per cell."""
    entries = []
    for stage in found().stages:
        if samples == 0:
            entries.append(Rated(stage, stage.metric, 0.0))
            continue
        say(f"rendering {stage.key}, {samples} samples per cell")
        bends = np.array(stage.scene.bending.angles)
        renders = tactilux.render_transport(
            stage.scene, stage.design.phi[:, None], bends, samples=samples
        )
        settings, power = stage.settings, stage.design.power

        def metric(T: Array, settings: Any = settings, power: Array = power) -> Array:
            return site_metric(image_counts(T, power, settings.exposure), settings.lam)

        noisy = np.random.default_rng(1).standard_normal((32, *renders.T[:, 0].shape))
        shaken = [metric(renders.T[:, 0] + renders.se[:, 0] * draw) for draw in noisy]
        se = float(np.std(shaken, axis=0).mean())
        entries.append(Rated(stage, metric(renders.T[:, 0]), se))
    return entries


def heat_maps(entries: Sequence[Rated], path: Path) -> dict[str, Any]:
    """Write Fig. 5.1: M at 15 sites, a row per bend and a column per design."""
    scene = entries[0].stage.scene
    bends = np.degrees(scene.bending.angles)
    rows, columns = scene.sites.rows, scene.sites.columns
    low = min(entry.metric.min() for entry in entries)
    high = max(entry.metric.max() for entry in entries)
    schemes = dict(design_pictures(scene, [entry.stage for entry in entries]))
    with drawing(8.0, 11.5) as figure:
        axes = figure.subplots(len(bends), len(entries))
        for column, entry in enumerate(entries):
            parts = design_score(entry.metric)
            axes[0][column].set_title(
                f"{TITLES[entry.stage.key]}\nS {parts.score:.0f} = {parts.mean:.0f} "
                f"- {parts.spread_sites:.0f} - {parts.spread_bends:.0f}",
                fontsize=9,
            )
            for row, bend in enumerate(bends):
                axis, values = axes[row][column], entry.metric[row].reshape(rows, columns)
                axis.imshow(values[::-1], vmin=low, vmax=high, cmap="viridis")
                for (y, x), value in np.ndenumerate(values[::-1]):
                    ink = "black" if value > (low + high) / 2 else "white"
                    axis.text(x, y, f"{value:.0f}", ha="center", va="center", color=ink, fontsize=8)
                axis.set(xticks=[], yticks=[])
                axis.set_ylabel(f"bend {bend:.0f}°" if column == 0 else "")
        path.write_bytes(png_bytes(figure, dpi=80))
    for entry in entries:
        name = f"scheme-{entry.stage.key}"
        path.with_name(f"{path.stem}-{name}.svg").write_bytes(schemes[name])
    return {
        entry.stage.key: {
            "M": entry.metric.round(2).tolist(),
            "se": entry.se,
            "colors": entry.stage.design.color_names,
            "angles_deg": np.degrees(entry.stage.design.phi).round(1).tolist(),
            **{name: float(getattr(design_score(entry.metric), name))
               for name in ("score", "mean", "spread_sites", "spread_bends")},
        }
        for entry in entries
    }  # fmt: skip


def patches(entries: Sequence[Rated], path: Path) -> dict[str, Any]:
    """Write Fig. 5.2: what the camera sees of each contact, a row per bend, a column per design."""
    scene = entries[0].stage.scene
    width = round(VIEW_ROWS * scene.camera.columns / scene.camera.rows)
    sites, bends = flat_sites(scene)[:, :2], scene.bending.angles
    step = np.linspace(-PATCH, PATCH, PATCH_PIXELS)
    grid = np.stack(np.meshgrid(step, step[::-1]), axis=-1)
    with tactilux.Preview(scene) as preview, drawing(8.0, 13.0) as figure:
        axes = figure.subplots(len(bends), len(entries))
        for row, bend in enumerate(bends):
            points = (sites[:, None, None] + grid).reshape(-1, 2)
            place = pixels_of(scene, bend, points, VIEW_ROWS, width)
            place = place.reshape(len(sites), *grid.shape)
            # The camera's x runs the other way: the drawing is the skin from outside.
            x = np.clip(width - 1 - place[..., 0].astype(int), 0, width - 1)
            y = np.clip(place[..., 1].astype(int), 0, VIEW_ROWS - 1)
            for column, entry in enumerate(entries):
                design = entry.stage.design
                seen = preview.picture(design.phi, design.power, bend, width, VIEW_ROWS)
                counts = np.asarray(seen[y, x], dtype=float) * entry.stage.settings.exposure
                tiles = encode_srgb(counts / 255).reshape(
                    scene.sites.rows, scene.sites.columns, PATCH_PIXELS, PATCH_PIXELS, 3
                )[::-1]
                axis = axes[row][column]
                axis.imshow(tiles.transpose(0, 2, 1, 3, 4).reshape(
                    scene.sites.rows * PATCH_PIXELS, scene.sites.columns * PATCH_PIXELS, 3
                ))  # fmt: skip
                axis.set(xticks=[], yticks=[])
                axis.set_ylabel(f"bend {np.degrees(bend):.0f}°" if column == 0 else "")
                if row == 0:
                    axis.set_title(TITLES[entry.stage.key], fontsize=9)
        path.write_bytes(png_bytes(figure, dpi=70))
    return {"patch_mm": 2 * PATCH, "sites_mm": sites.tolist()}


def bolts(entries: Sequence[Rated], path: Path) -> dict[str, Any]:
    """Write Fig. 5.3: a bolt near the base, baseline and optimized design, a row per bend."""
    shown = [entries[0].stage, entries[-1].stage]
    pictures = bolt_pictures(shown[0].scene, [stage.design for stage in shown], shown[0].settings)
    bends = np.degrees(shown[0].scene.bending.angles)
    contrast: dict[str, list[float]] = {}
    with drawing(5.0, 11.0) as figure:
        axes = figure.subplots(len(bends), 2)
        for column, (stage, column_pictures) in enumerate(zip(shown, pictures, strict=True)):
            for row, picture in enumerate(column_pictures):
                image = imread(io.BytesIO(picture))[..., :3]
                axis = axes[row][column]
                axis.imshow(image)
                axis.set(xticks=[], yticks=[])
                axis.set_ylabel(f"bend {bends[row]:.0f}°" if column == 0 else "")
                contrast.setdefault(stage.key, []).append(edge_contrast(image))
            axes[0][column].set_title(TITLES[stage.key], fontsize=9)
        path.write_bytes(png_bytes(figure, dpi=70))
    return {"edge_contrast": contrast}


def edge_contrast(image: Array) -> float:
    """Return how much the color turns at its sharpest places: the 99.5th percentile of its slope.

    In units of full white per pixel of the picture, away from the pad's outline.
    """
    lit = image.max(axis=-1) > 0.02
    slope = np.hypot(*(np.linalg.norm(np.gradient(image, axis=axis), axis=-1) for axis in (0, 1)))
    inner = lit.copy()
    for axis in (0, 1):
        for shift in (-8, 8):
            inner &= np.roll(lit, shift, axis=axis)
    return float(np.percentile(slope[inner], 99.5))
