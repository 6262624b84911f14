"""The model that a scene has before anything was rendered: its preview, with measured intervals.

Colors superpose the preview's transport at Chebyshev nodes in direction and bend; there is no
residual. The coarse preview is the shader's, and there in seconds. Two others correct its transport
by that of `render.preview.converged`: of few light paths, some seconds later, and the converged
one, in one to three minutes. How far each is from the reference was measured once
(``tests/validation/test_preview_model.py``); `preview_interval` makes it the intervals of a scene.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.chebyshev import interpolation_weights
from render.choose_exposure import ScoreScale, baseline_power, scene_scale
from render.files import read_or_drop, write_npz
from render.levels import CONVERGED, FEW_PATHS, Effort, level_name, level_of
from render.metric import clip_counts, design_score, site_metric
from render.preview.converged import (
    ConvergedTransport,
    converged_transport,
    few_paths_transport,
    phi_nodes,
)
from render.preview.diffuser.cache import cache_folder
from render.progress import OnProgress, in_stage
from render.scene import Scene
from surrogate.model.converged_grid import corrected
from surrogate.model.lamp_copies import copied, split_power
from surrogate.model.preview_grid import PreviewGrid, draw_grid
from surrogate.model.scene_facts import grid_facts, scene_facts
from surrogate.preview_interval import (
    COVERAGE,
    drawn_half_width,
    followed_half_width,
    preview_difference,
)
from surrogate.runtime import Checker, ModelMetadata
from surrogate.runtime.metadata import NONE, UNITS

PHI_NODES, BEND_NODES = 33, 9
VERSION = 4
"""Part of the cache key: raise it when the preview changes."""
COUNTS_FACTOR = 1.645
"""The 90 % interval of a color, in standard deviations: errors were about normal."""


@dataclass(frozen=True)
class PreviewErrors:
    """How far a preview is from the reference, measured on sensors that it was not made for.

    Arguments:
        effort: `FEW_PATHS` or `CONVERGED` of traced light, None as drawn.
        color_spread: relative, of channels of facets: the error that holds 90 % of them over
            `COUNTS_FACTOR`.
        facet_median, facet_p95: of colors, relative.
        score_median, score_p95: of scores, counts.
        kendall_tau: of its ranking of random designs.
    """

    effort: Effort | None
    color_spread: float
    facet_median: float
    facet_p95: float
    score_median: float
    score_p95: float
    kendall_tau: float

    def held_out(self) -> dict[str, object]:
        """Return the errors as the metadata of a trained model has them."""
        names = ("facet_median", "facet_p95", "score_median", "score_p95", "kendall_tau")
        level = level_of(self.effort)
        about = {"name": level_name(level, self.effort), "level": level, "effort": self.effort}
        return about | {name: getattr(self, name) for name in names}


COARSE_ERRORS = PreviewErrors(None, 0.22, 0.22, 0.6, 11.0, 35.0, 0.73)
FEW_PATHS_ERRORS = PreviewErrors(FEW_PATHS, 0.067, 0.047, 0.14, 4.0, 12.0, 0.89)
CONVERGED_ERRORS = PreviewErrors(CONVERGED, 0.027, 0.02, 0.06, 2.0, 6.0, 0.9)
CACHED = ("log_transport", "phi", "bends", "floored_exposure_lambda")


def preview_checker(
    scene: Scene, progress: OnProgress | None = None, *, coarse: bool = False
) -> Checker:
    """Return a checker of ``scene`` on its preview, without renders.

    The converged one, in one to three minutes; with ``coarse`` the shader's, in seconds, but for
    scenes under a window of another index than the pad's, where the shader lacks up to a third of
    the light: that of `few_paths_checker`. All are kept in the user's cache, by the scene's hash.

    Raises:
        GraphicsError: no OpenGL library can draw.
        TableError: the preview is black or not finite.
    """
    if not coarse:
        return _followed(scene, converged_transport, CONVERGED_ERRORS, progress)
    if scene.window_refracts:
        return few_paths_checker(scene, progress)
    grid, scale = _drawn(scene, in_stage(progress, "drawing the pad"))
    half_width = preview_half_width(scene, scale, grid)
    session = PreviewSession(scene, grid, scale, COARSE_ERRORS.color_spread)
    return Checker(session, _about(scene, grid, scale, COARSE_ERRORS, half_width))


def few_paths_checker(scene: Scene, progress: OnProgress | None = None) -> Checker:
    """Return a checker of ``scene`` on its preview as few light paths correct it.

    It raises what `preview_checker` does.
    """
    return _followed(scene, few_paths_transport, FEW_PATHS_ERRORS, progress)


def _followed(
    scene: Scene,
    transport: Callable[[Scene, OnProgress | None], ConvergedTransport],
    errors: PreviewErrors,
    progress: OnProgress | None,
) -> Checker:
    grid, scale = _drawn(scene, in_stage(progress, "drawing the pad"))
    light = transport(scene, in_stage(progress, "following light"))
    followed = corrected(grid, scene, light)
    half_width = preview_half_width(scene, scale, grid, followed)
    session = PreviewSession(scene, followed, scale, errors.color_spread)
    return Checker(session, _about(scene, followed, scale, errors, half_width))


def preview_nodes(scene: Scene) -> tuple[int, int]:
    """Return the grid's nodes in direction and bend: narrow beams have more directions."""
    return max(PHI_NODES, len(phi_nodes(scene))), BEND_NODES


def preview_half_width(
    scene: Scene, scale: ScoreScale, drawn: PreviewGrid, followed: PreviewGrid | None = None
) -> float:
    """Return the half-width of scores, counts, of the followed grid, or of the drawn one alone."""
    bends = np.array(scene.state_axis)
    sessions = [
        PreviewSession(scene, grid, scale, CONVERGED_ERRORS.color_spread)
        for grid in (drawn, followed or drawn)
    ]
    phi, power = np.full((1, scene.lamp_count), np.pi / 2), baseline_power(scene)[None]
    metric = sessions[1].outputs(phi, power, bends)["metric"]
    mean = float(design_score(metric).mean[0])
    if followed is None:
        return drawn_half_width(mean)
    scores = [
        lambda phi, power, one=one: one.outputs(phi, power, bends)["score"] for one in sessions
    ]
    difference = preview_difference(scene, *scores)
    noise = followed.photon_noise or 0.0
    return followed_half_width(scene, mean, scale.lam, difference, noise)


class PreviewSession:
    """Answers as an onnxruntime session of ``checker.onnx`` does, from the preview, in numpy.

    Arguments:
        scene: the sensor.
        grid: the preview at its nodes.
        scale: exposure and lambda.
        color_spread: of a facet's color, relative (`PreviewErrors`).
    """

    def __init__(
        self, scene: Scene, grid: PreviewGrid, scale: ScoreScale, color_spread: float
    ) -> None:
        """Keep the grid."""
        self._scene = scene
        self._grid, self._scale, self._color_spread = grid, scale, color_spread

    def run(self, names: Sequence[str], feeds: Mapping[str, Array]) -> list[Array]:
        """Return the outputs ``names`` as float32; the same bends for all designs."""
        found = self.outputs(feeds["phi"], feeds["power"], feeds["bend"][0])
        return [np.asarray(found[name], dtype=np.float32) for name in names]

    def outputs(self, phi: Array, power: Array, bends: Array) -> dict[str, Array]:
        """Return all outputs in float64, shaped as :meth:`Checker.run` says.

        Directions and bends outside the grid are moved to its edge; ``domain_excess`` says so.
        """
        grid, bends = self._grid, np.asarray(bends, dtype=np.float64)
        phi, power = copied(self._scene, phi, axis=1), split_power(self._scene, power)
        low, high = float(grid.bends.min()), float(grid.bends.max())
        inside = np.clip(bends, low, high)
        if self._scene.states is not None:
            inside = np.round(inside)
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
            "counts_spread": self._color_spread * facets,
            "background": counts[..., -1, :],
            "metric": metric,
            "score": np.asarray(design_score(metric).score),
            "domain_excess": np.full(len(light), beyond),
        }


def _drawn(scene: Scene, progress: OnProgress | None) -> tuple[PreviewGrid, ScoreScale]:
    """Return grid and scale, from the cache or drawn now."""
    nodes = preview_nodes(scene)
    about = f"{VERSION} {scene.hash} {nodes[0]} {nodes[1]}"
    key = hashlib.sha256(about.encode()).hexdigest()[:16]
    file = cache_folder() / f"preview-{key}.npz"
    kept = read_or_drop(file, *CACHED)
    if kept is not None:
        log, phi, bends, rest = (kept[name] for name in CACHED)
        return PreviewGrid(log, phi, bends, int(rest[0])), ScoreScale(*map(float, rest[1:]))
    grid = draw_grid(scene, *nodes, progress)
    scale = scene_scale(scene)
    rest = np.array([grid.floored, scale.exposure, scale.lam])
    arrays = (grid.log_transport, grid.phi, grid.bends, rest)
    try:
        write_npz(file, dict(zip(CACHED, arrays, strict=True)))
    except OSError as error:
        warnings.warn(f"the preview cannot be cached: {error}", stacklevel=3)
    return grid, scale


def _about(
    scene: Scene, grid: PreviewGrid, scale: ScoreScale, errors: PreviewErrors, half_width: float
) -> ModelMetadata:
    """Return what the checker says about itself, with the ``half_width`` of scores in counts."""
    return ModelMetadata(
        **scene_facts(scene, grid),
        exposure=scale.exposure,
        lam=scale.lam,
        conformal={"coverage": COVERAGE, "counts": COUNTS_FACTOR, "score": half_width},
        held_out=[errors.held_out()],
        preview=grid_facts(grid) | {"effort": errors.effort},
        renderer={},
        training_data_hash="",
        git_revision="",
        versions={},
        residual={"kind": NONE},
        units=UNITS,
    )
