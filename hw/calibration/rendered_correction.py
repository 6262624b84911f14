"""What renders of one material know better than the model of all materials.

The ratio of rendered to modelled light is smooth over the pad and alike for all fibers, while the
renders' own noise is neither. So the logarithm of the ratio at the reference lines is taken as a
Gaussian process in the fiber's frame (Rasmussen and Williams 2006, eq. 2.25 and 2.26): a constant
of each fiber, a field that all fibers share, and a field of its own for each. Its mean corrects
the model; draws from what it leaves open say how wrong the corrected model may still be.

Near the rendered material the model is then the reference itself; only its change with the
material is the preview's ("space mapping": Bandler et al. 1994).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw.calibration.reference_lines import ReferenceLines, frame_positions
from hw.pad_light import PadLight
from render.bending import Array

REACH = 4.0
"""Distance (mm) over which the ratio changes."""
SIZES = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)
"""Relative sizes of the shared and of the own fields; the data choose, bend by bend."""
LOOSE = 1.0
"""Spread of each fiber's constant: nothing is known about it, its power takes it up."""
WORST = 0.3
"""Relative error of a rendered block from which it tells nothing."""
DRAWS = 200


@dataclass(frozen=True, eq=False)
class RenderedCorrection:
    """Rendered over modelled light at the reference lines.

    Arguments:
        log_ratio: ``(bend, fiber, point)``; 0 where nothing was rendered.
        draws: ``(draw, bend, fiber, point)`` log errors that it may still have.
        noise: ``(bend,)`` rms of these draws, each fiber's constant taken out.
    """

    log_ratio: Array
    draws: Array
    noise: Array


def rendered_correction(
    light: PadLight, log_light: Array, lines: ReferenceLines
) -> RenderedCorrection:
    """Return the correction that ``light`` asks for.

    Arguments:
        light: rendered, of the fibers that matter at each bend.
        log_light: ``(bend, fiber, point)`` of the model for the same material, NaN where the
            camera sees nothing.
        lines: of the scene.
    """
    log_ratio = np.zeros(log_light.shape)
    draws = np.zeros((DRAWS, *log_light.shape))
    rng = np.random.default_rng(5)
    for bend in range(len(log_light)):
        lit = np.nonzero(np.isfinite(light.radiance[bend]).any(axis=(1, 2)))[0].tolist()
        data = [_samples(light, log_light[bend, fiber], lines, bend, fiber) for fiber in lit]
        wanted = [np.nonzero(np.isfinite(log_light[bend, fiber]))[0] for fiber in lit]
        if not sum(len(ratio) for _, ratio, _ in data):
            continue
        mean, spread = _posterior(data, [frame_positions()[points] for points in wanted])
        root = np.linalg.cholesky(spread + 1e-10 * np.eye(len(spread)))
        several = rng.standard_normal((DRAWS, len(mean))) @ root.T
        edges = np.cumsum([0, *(len(points) for points in wanted)])
        for fiber, points, first, last in zip(lit, wanted, edges, edges[1:], strict=False):
            log_ratio[bend, fiber, points] = mean[first:last]
            draws[:, bend, fiber, points] = several[:, first:last]
    shaped = draws - draws.mean(axis=-1, keepdims=True)
    known = log_ratio != 0
    square = (shaped**2).mean(axis=0)
    noise = np.array(
        [np.sqrt(square[bend][on].mean()) if on.any() else 0.0 for bend, on in enumerate(known)]
    )
    return RenderedCorrection(log_ratio, draws, noise)


def _samples(
    light: PadLight, log_light: Array, lines: ReferenceLines, bend: int, fiber: int
) -> tuple[Array, Array, Array]:
    """Return what renders tell about one fiber: place in its frame, log ratio, variance.

    One sample per cell, whose blocks share their error.
    """
    position = lines.position[fiber]
    radiance, error = light.at(bend, fiber, position)
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = error / radiance
        useful = np.isfinite(log_light) & (relative < WORST) & (radiance > 0)
    variance = relative[useful] ** 2
    # The logarithm of a noisy mean is too small by half its relative variance.
    ratio = np.log(radiance[useful]) + 0.5 * variance - log_light[useful]
    _, cell, size = np.unique(
        light.cell_of(position[useful]), return_inverse=True, return_counts=True
    )

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(cell, values) / size)

    place = np.stack([mean(values) for values in frame_positions()[useful].T], axis=-1)
    return place, mean(ratio), mean(variance)


def _posterior(data: list[tuple[Array, Array, Array]], wanted: list[Array]) -> tuple[Array, Array]:
    """Return mean and covariance at the places ``wanted`` of every fiber, one after the other."""
    seen = [place for place, _, _ in data]
    ratio = np.concatenate([values for _, values, _ in data])
    noise = np.diag(np.concatenate([variance for _, _, variance in data]))
    smooth, same = _kernels(seen, seen)
    best, chosen = -np.inf, (SIZES[0], SIZES[0])
    for shared in SIZES:
        for own in SIZES:
            root = np.linalg.cholesky(
                LOOSE**2 * same + smooth * (shared**2 + own**2 * same) + noise
            )
            white = np.linalg.solve(root, ratio)
            # Log marginal likelihood, Rasmussen and Williams 2006, eq. 2.30.
            likelihood = -0.5 * float(white @ white) - float(np.log(np.diag(root)).sum())
            if likelihood > best:
                best, chosen = likelihood, (shared, own)
    shared, own = chosen

    def covariance(a: list[Array], b: list[Array]) -> Array:
        smooth, same = _kernels(a, b)
        return np.asarray(LOOSE**2 * same + smooth * (shared**2 + own**2 * same))

    across = covariance(wanted, seen)
    gain = np.linalg.solve(covariance(seen, seen) + noise, across.T).T
    spread = covariance(wanted, wanted) - gain @ across.T
    return gain @ ratio, 0.5 * (spread + spread.T)


def _kernels(a: list[Array], b: list[Array]) -> tuple[Array, Array]:
    """Return closeness of places in the fiber's frame, and whether they are of the same fiber."""
    own = [np.repeat(np.arange(len(side)), [len(place) for place in side]) for side in (a, b)]
    where = [np.concatenate(side) for side in (a, b)]
    away = ((where[0][:, None] - where[1][None]) ** 2).sum(axis=-1)
    same = (own[0][:, None] == own[1][None]).astype(np.float64)
    return np.exp(-0.5 * away / REACH**2), same
