"""All pictures of a night's report, as PNG bytes by name."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from optimize.design.design import Array
from optimize.overnight.drawings import (
    color_scatter,
    convergence,
    score_scatter,
    speed_accuracy,
    timed_levels,
)
from optimize.overnight.result import OvernightResult
from optimize.report.drawings import scheme
from optimize.report.heatmaps import facet_strip, metric_strip, picture_png, png_bytes
from render.geometry.indenter import bolt
from render.preview.preview import Preview

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
    bright = result.scale.exposure / result.scale.conventions.count_max
    return {name: picture_png(np.rot90(seen[frame]) * bright) for name, seen in drawn.items()}
