"""The model that a scene has before anything was rendered: its preview, with measured intervals.

Colors superpose the preview's transport at Chebyshev nodes in direction and bend; there is no
residual. How far the preview is from level 2 was measured once, on finger20 and on random sensors
of the family (``tests/validation/test_preview_model.py``), and gives the intervals of every scene.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from render.arrays import Array
from render.chebyshev import interpolation_weights
from render.files import read_or_drop, write_npz
from render.metric import clip_counts, design_score, site_metric
from render.preview.diffuser.cache import cache_folder
from render.progress import OnProgress
from render.scale import ScoreScale, baseline_power, scene_scale
from render.scene import Scene
from surrogate.model.preview_grid import PreviewGrid, draw_grid
from surrogate.model.scene_facts import grid_facts, scene_facts
from surrogate.runtime import Checker, ModelMetadata
from surrogate.runtime.metadata import PREVIEW, UNITS

PHI_NODES, BEND_NODES = 33, 9
VERSION = 3
"""Part of the cache key: raise it when the preview changes."""
COVERAGE = 0.9
COLOR_SPREAD = 0.2
"""One standard deviation of a facet's color, relative."""
COUNTS_FACTOR = 2.0
"""The interval of a color, in standard deviations."""
SCORE_FRACTION = 0.16
"""Half-width of the interval of a score, as a fraction of the baseline's mean M."""
MEASURED: dict[str, Any] = {
    "level": PREVIEW,
    "facet_median": 0.22,
    "facet_p95": 0.6,
    "score_median": 11.0,
    "score_p95": 35.0,
    "kendall_tau": 0.73,
}
"""Errors against level 2 on held-out sensors, as in the metadata of a trained model."""
CACHED = ("log_transport", "phi", "bends", "floored_exposure_lambda")


def preview_checker(scene: Scene, progress: OnProgress | None = None) -> Checker:
    """Return a checker of ``scene`` on the preview alone, level 0, ready in seconds.

    What is drawn is kept in the user's cache, by the scene's hash.

    Raises:
        GraphicsError: no OpenGL library can draw.
        TableError: the preview is black or not finite.
    """
    grid, scale = _drawn(scene, progress)
    session = PreviewSession(grid, scale)
    bends = np.array(scene.bending.angles)
    phi = np.full((1, scene.lamp_count), np.pi / 2)
    metric = session.outputs(phi, baseline_power(scene)[None], bends)["metric"]
    mean = float(design_score(metric).mean[0])
    return Checker(session, _about(scene, grid, scale, SCORE_FRACTION * mean))


class PreviewSession:
    """Answers as an onnxruntime session of ``checker.onnx`` does, from the preview, in numpy.

    Arguments:
        grid: the preview at its nodes.
        scale: exposure and lambda.
    """

    def __init__(self, grid: PreviewGrid, scale: ScoreScale) -> None:
        """Keep the grid."""
        self._grid, self._scale = grid, scale

    def run(self, names: Sequence[str], feeds: Mapping[str, Array]) -> list[Array]:
        """Return the outputs ``names`` as float32; the same bends for all designs."""
        found = self.outputs(feeds["phi"], feeds["power"], feeds["bend"][0])
        return [np.asarray(found[name], dtype=np.float32) for name in names]

    def outputs(self, phi: Array, power: Array, bends: Array) -> dict[str, Array]:
        """Return all outputs in float64, shaped as :meth:`Checker.run` says.

        Directions and bends outside the grid are moved to its edge; ``domain_excess`` says so.
        """
        grid, bends = self._grid, np.asarray(bends, dtype=np.float64)
        low, high = float(grid.bends.min()), float(grid.bends.max())
        inside = np.clip(bends, low, high)
        # Callers hand float32 on: what rounds to the same number there is inside.
        outside = np.float32(inside) != np.float32(bends)
        beyond = (outside * np.abs(inside - bends)).max() / ((high - low) or 1.0)
        at_bends = np.einsum(
            "qb,fjbsn->fjqsn", interpolation_weights(grid.bends, inside), grid.log_transport
        )
        weights = interpolation_weights(grid.phi, np.clip(phi, grid.phi[0], grid.phi[-1]))
        light = np.exp(np.einsum("dfj,fjqsn->dfqsn", weights, at_bends, optimize=True))
        colors = np.einsum("dfqsn,dfc->dqsnc", light, power, optimize=True)
        counts = np.asarray(clip_counts(self._scale.exposure * colors))
        facets = counts[..., :-1, :]
        metric = np.asarray(site_metric(facets, self._scale.lam))
        return {
            "counts": facets,
            "counts_spread": COLOR_SPREAD * facets,
            "background": counts[..., -1, :],
            "metric": metric,
            "score": np.asarray(design_score(metric).score),
            "domain_excess": np.full(len(light), beyond),
        }


def _drawn(scene: Scene, progress: OnProgress | None) -> tuple[PreviewGrid, ScoreScale]:
    """Return grid and scale, from the cache or drawn now."""
    about = f"{VERSION} {scene.hash} {PHI_NODES} {BEND_NODES}"
    key = hashlib.sha256(about.encode()).hexdigest()[:16]
    file = cache_folder() / f"preview-{key}.npz"
    kept = read_or_drop(file, *CACHED)
    if kept is not None:
        log, phi, bends, rest = (kept[name] for name in CACHED)
        return PreviewGrid(log, phi, bends, int(rest[0])), ScoreScale(*map(float, rest[1:]))
    grid = draw_grid(scene, PHI_NODES, BEND_NODES, progress)
    scale = scene_scale(scene)
    rest = np.array([grid.floored, scale.exposure, scale.lam])
    arrays = (grid.log_transport, grid.phi, grid.bends, rest)
    try:
        write_npz(file, dict(zip(CACHED, arrays, strict=True)))
    except OSError as error:
        warnings.warn(f"the preview cannot be cached: {error}", stacklevel=3)
    return grid, scale


def _about(scene: Scene, grid: PreviewGrid, scale: ScoreScale, half_width: float) -> ModelMetadata:
    """Return what the checker says about itself; nothing was rendered for it."""
    return ModelMetadata(
        **scene_facts(scene, grid),
        exposure=scale.exposure,
        lam=scale.lam,
        conformal={"coverage": COVERAGE, "counts": COUNTS_FACTOR, "score": half_width},
        held_out=[MEASURED],
        preview=grid_facts(grid),
        renderer={},
        training_data_hash="",
        git_revision="",
        versions={},
        residual={"kind": PREVIEW},
        units=UNITS,
    )
