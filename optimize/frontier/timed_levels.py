"""Speed beside known accuracy: what a level's design takes here, with the errors of its model."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from render.preview import Preview
from render.scene import Scene
from surrogate.runtime import Checker

TIMED_RUNS = 20
"""Designs whose median time is that of a level."""


def timed_levels(
    scene: Scene, checker: Checker, render_seconds: Sequence[float]
) -> list[tuple[str, float, float, float, float, float]]:
    """Return speed and accuracy of preview, model and renders, from quick to slow.

    Of each its name, seconds per design (measured here) and, from the model's metadata, median and
    95th percentile of the error of facet colors, median error of S, and Kendall's tau.

    Arguments:
        scene: the sensor.
        checker: its model.
        render_seconds: of renders as noisy as those that the model was trained with.
    """
    held = {str(row["level"]): row for row in checker.metadata.held_out}
    bends = np.array(scene.bending.angles)
    phi = np.full((1, scene.fibers.count), np.pi / 2)
    power = np.ones((1, scene.fibers.count, 3))
    with Preview(scene) as preview:
        drawn = _median_seconds(lambda: preview.transport(phi[0, :1], bends))
    found = _median_seconds(lambda: checker.run(phi, power, bends))
    rows = [("preview", drawn, "preview")]
    rows += [("surrogate", found, str(checker.metadata.residual["kind"]))]
    if len(render_seconds):
        seconds = float(np.median(render_seconds))
        rows += [("a render of one round", seconds, "noise of the reference")]
    keys = ("facet_median", "facet_p95", "score_median", "kendall_tau")
    errors = {name: [float(held[name][key]) for key in keys] for *_, name in rows if name in held}
    return [
        (title, seconds, *errors[name])  # type: ignore[misc]
        for title, seconds, name in sorted(rows, key=lambda row: row[1])
        if name in errors
    ]


def _median_seconds(work: Callable[[], object]) -> float:
    work()
    spent = []
    for _ in range(TIMED_RUNS):
        began = time.perf_counter()
        work()
        spent.append(time.perf_counter() - began)
    return float(np.median(spent))
