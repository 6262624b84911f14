"""Drawings of a design and of the search: which light is where, and how the score rose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from optimize.design.design import Design
from optimize.report.heatmaps import drawing
from optimize.search.joint import SearchStep
from render.geometry.layout import flat_fiber_poses, flat_sites
from render.scene.schema import Scene

# What each stage of the search is called and drawn with.
STAGES = {
    "start": ("baseline", "#1c1f24"),
    "grouped": ("colors in pairs", "#93b4f5"),
    "quick": ("colors, 2-opt", "#2f5fd0"),
    "tied": ("directions, tied", "#e0a458"),
    "free": ("directions, free", "#b45309"),
    "power": ("LED powers", "#7c3aed"),
}

INK = {"red": "#d1352b", "green": "#1e9e4a", "blue": "#2f5fd0", "off": "#9aa0aa"}


def scheme(scene: Scene, design: Design) -> Figure:
    """Draw the pad from outside, tip up, with every fiber's color, number and direction."""
    poses = flat_fiber_poses(scene)
    beams = poses.directions(design.phi, 0.0)
    half = np.array([scene.pad.width, scene.pad.length]) / 2
    edge = scene.diffuser.thickness if scene.diffuser else 0.0
    margin = edge + scene.fibers.gap + 3.2
    width, height = 2 * (half + margin)
    with drawing(2.3, 2.3 * (height - margin + 1.0) / width) as figure:
        axes = figure.subplots()
        if edge:
            axes.add_patch(
                Rectangle(
                    (-half[0] - edge, -half[1]),
                    2 * (half[0] + edge),
                    2 * half[1] + edge,
                    facecolor="#e6e8ec",
                    edgecolor="none",
                )
            )
        axes.add_patch(
            Rectangle(tuple(-half), *(2 * half), facecolor="#f6f7f9", edgecolor="#b6bbc4", lw=0.6)
        )
        sites = flat_sites(scene)
        axes.plot(sites[:, 0], sites[:, 1], "o", ms=2.0, color="#b6bbc4")
        for number, (at, beam, inward, color) in enumerate(
            zip(poses.position, beams, poses.inward, design.color_names, strict=True)
        ):
            ink = INK[color]
            axes.annotate(
                "",
                xy=tuple((at + 3.4 * beam)[:2]),
                xytext=tuple(at[:2]),
                arrowprops={"arrowstyle": "-|>", "color": ink, "lw": 1.3, "mutation_scale": 7},
            )
            axes.plot(at[0], at[1], "o", ms=4.0, color=ink)
            label = at - 1.9 * inward
            axes.text(label[0], label[1], str(number), ha="center", va="center", fontsize=7.5)
        axes.set(
            xlim=(-half[0] - margin, half[0] + margin), ylim=(-half[1] - 1.0, half[1] + margin)
        )
        axes.set_aspect("equal")
        axes.axis("off")
    return figure


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
