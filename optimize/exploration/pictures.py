"""All pictures of an exploration, as PNG bytes by name."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from optimize.exploration.explore import Exploration
from optimize.report.drawings import convergence, scheme
from optimize.report.heatmaps import facet_strip, metric_strip, picture_png, png_bytes
from render.metric import THESIS

PREVIEW_WIDTH = 240  # pixels; the height follows from the camera


def explore_pictures(exploration: Exploration) -> Iterator[tuple[str, bytes]]:
    """Yield ``(name, PNG)``: schemes, heat maps and facets of every stage, previews, convergence.

    Preview pictures are made for the first and the last stage, at every bend; brightness is
    exposed as the scene's camera is, so that pictures can be compared.
    """
    scene, stages = exploration.scene, exploration.stages
    maps = np.stack([stage.metric for stage in stages])
    for stage in stages:
        yield f"scheme-{stage.key}", png_bytes(scheme(scene, stage.design))
        strip = metric_strip(scene, stage.metric, float(maps.min()), float(maps.max()))
        yield f"metric-{stage.key}", png_bytes(strip)
        yield f"facets-{stage.key}", png_bytes(facet_strip(scene, stage.counts))
    yield "convergence", png_bytes(convergence(exploration.search.history))
    yield from _previews(exploration)


def _previews(exploration: Exploration) -> Iterator[tuple[str, bytes]]:
    from render.preview.preview import Preview

    scene = exploration.scene
    height = round(PREVIEW_WIDTH * scene.camera.rows / scene.camera.columns)
    with Preview(scene) as preview:
        for stage in (exploration.stages[0], exploration.stages[-1]):
            for index, bend in enumerate(scene.bending.angles):
                radiance = preview.picture(
                    stage.design.phi, stage.design.power, bend, PREVIEW_WIDTH, height
                )
                counts = np.asarray(radiance, dtype=np.float64) * stage.rating.exposure
                yield f"preview-{stage.key}-{index}", picture_png(counts / THESIS.count_max)
