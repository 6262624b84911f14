"""The table itself as the model, where a design only superposes what was rendered.

On a pad that does not bend, lit by lamps that cannot turn, preview and renders have one node, and
nothing between nodes is left to learn. Every cell is then the mean of preview P and render T,
weighed by their variances (empirical Bayes: Robbins 1956, Efron and Morris 1973):

    P + w (T - P),  w = tau^2 / (tau^2 + sigma^2)

with sigma the render's standard error and tau what the preview is off by, both in units of P, or of
`DARK` of the mean light at the site where a cell is darker. tau is that with which one half of the
light paths foretells the other best (`surrogate.training.halves`); where none is borne out, the
preview stays as it is.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from render.arrays import Array
from render.levels import PREVIEW, TABLE
from surrogate.model.facet_basis import SIZE
from surrogate.model.networks import NoResidual
from surrogate.model.preview_grid import PreviewGrid
from surrogate.runtime.metadata import NOISE, NONE
from surrogate.training.conformal import (
    Comparison,
    compare,
    conformal,
    counts_spread,
    coverage,
    fit_spread,
)
from surrogate.training.dataset import NOISE_FLOOR
from surrogate.training.evaluation import HeldOutErrors, HeldOutEvaluation
from surrogate.training.fit import Fit, rendered_again
from surrogate.training.fit_task import FitTask
from surrogate.training.halves import borne_out

DARK = 0.1
"""Fraction of a site's mean light below which the errors of a cell are told in units of that."""
LOUD = 3.0
"""Noise of a held-out color, in standard deviations of the model, that still tells of the model."""
TAUS = tuple(0.0025 * 2.0**step for step in range(14))
"""Errors of the preview that are tried, relative: up to 20, which is the table alone."""


def fit_table(task: FitTask) -> tuple[Fit, PreviewGrid]:
    """Return what is known of the model's errors, and the grid that it is.

    All errors are of a model of one half of the light paths against the other half. The whole
    model knows cells better, by the ratio of the standard deviations that both means of preview
    and render have; its spread is told so. The tau of the table alone is of the whole against the
    truth, from that of the halves by the formula of Spearman (1910) and Brown (1910).
    """
    cells, rows = task.cells, task.rows
    assert cells.half_difference is not None  # a table that was rendered, see `train`
    preview = np.exp(rows.log_preview)
    noise = math.sqrt(2.0) * rows.noise.double().numpy().reshape(preview.shape)
    unit = np.maximum(preview, DARK * preview.mean(axis=(0, 1, 4), keepdims=True))
    halves = [cells.transport + cells.half_difference, cells.transport - cells.half_difference]
    gains = [_gains(preview, halves, noise, unit, tau) for tau in TAUS]
    best = int(np.argmax([gain.mean() for gain in gains]))
    kept = borne_out(gains[best], len(task.scene.albedos))
    tau = TAUS[best] if kept else 0.0
    guesses = [_shrunk(preview, half, noise, unit, tau) for half in halves]
    whole = _shrunk(preview, cells.transport, noise / math.sqrt(2.0), unit, tau)

    grid = replace(task.grid, log_transport=np.log(whole).swapaxes(0, 1))
    brightness = np.broadcast_to(
        replace(task, grid=grid).rows.brightness[..., None], preview.shape
    ).ravel()
    pairs = list(zip(guesses, halves[::-1], strict=True))
    error = math.sqrt(2.0) * cells.error
    spread = fit_spread(
        np.concatenate([(held / guess - 1.0).ravel() for guess, held in pairs]),
        np.concatenate([(error / guess).ravel() for guess, _ in pairs]),
        np.zeros(2 * preview.size),
        np.tile(brightness, 2),
    )
    cell_spread = np.exp(spread[0] + spread[1] * brightness.reshape(preview.shape)[..., 0])
    against = [replace(task.overall, reference=held, error=error) for _, held in pairs]
    compared = [
        replace(_compared(evaluation, guess, cell_spread, task.seed), noise_share=task.noise_share)
        for evaluation, (guess, _) in zip(against, pairs, strict=True)
    ]
    levels = [
        _errors(task.overall, NOISE, rendered_again(task)),
        _errors(task.overall, PREVIEW, preview),
    ]
    if kept:
        found = [
            _errors(evaluation, TABLE, guess)
            for evaluation, (guess, _) in zip(against, pairs, strict=True)
        ]
        levels.append(_mean_errors(found))
    first, second = compared
    known = task.preview_half_width
    tried = (
        coverage(second, conformal(first, known)),
        coverage(first, conformal(second, known)),
    )
    narrower = _spread_of(preview, cells.transport, noise / math.sqrt(2.0), unit, tau)
    narrower /= _spread_of(preview, cells.transport, noise, unit, tau)
    fit = Fit(
        residual=NoResidual(SIZE),
        kind=TABLE if kept else NONE,
        spread=(spread[0] + math.log(narrower), spread[1]),
        quantiles=conformal(_joined(first, second), known),
        coverage=replace(
            tried[0],
            counts=float(np.mean([part.counts for part in tried])),
            score=float(np.mean([part.score for part in tried])),
        ),
        levels=tuple(levels),
        splits=(),
        unreliable=int((~cells.reliable).sum()),
        cells=int(cells.reliable.size),
        noise=float(rows.noise.median()),
        by_paths=True,
    )
    return fit, grid


def _shrunk(preview: Array, render: Array, noise: Array, unit: Array, tau: float) -> Array:
    """Return the mean of preview and render; ``noise`` is the render's relative standard error.

    It is positive, as the preview is and no render is below 0.
    """
    sigma = noise * np.maximum(preview, render) / unit
    weight = tau**2 / (tau**2 + np.maximum(sigma, 1e-6) ** 2)
    return np.asarray(preview + weight * (render - preview))


def _spread_of(preview: Array, render: Array, noise: Array, unit: Array, tau: float) -> float:
    """Return the deviation of `_shrunk`, root mean square in ``unit``; 1 for the preview alone."""
    if tau == 0.0:
        return 1.0
    sigma = noise * np.maximum(preview, render) / unit
    return float(np.sqrt(np.mean(tau**2 * sigma**2 / (tau**2 + sigma**2))))


def _gains(preview: Array, halves: list[Array], noise: Array, unit: Array, tau: float) -> Array:
    """Return by lamp and site how much better a half foretells the other than the preview does.

    In squared units per cell, weighed by the noise; without bias, see `surrogate.training.halves`.
    Sites share light paths, but what they share in one half says nothing of the other: few lamps
    are no fewer observations.
    """
    weight = NOISE_FLOOR**2 / (NOISE_FLOOR**2 + (noise * preview / unit) ** 2)
    gains = []
    for fitted, held in (halves, halves[::-1]):
        moved = (_shrunk(preview, fitted, noise, unit, tau) - preview) / unit
        gain = weight * moved * (2.0 * (held - preview) / unit - moved)
        gains.append(gain.sum(axis=(0, 2, 4)) / weight.sum(axis=(0, 2, 4)))
    return np.asarray(np.mean(gains, axis=0)).ravel()


def _compared(
    evaluation: HeldOutEvaluation, transport: Array, cell_spread: Array, seed: int
) -> Comparison:
    """Return the comparison, with those colors alone of which the renders know something.

    A cell whose few bright paths make its error bar far larger than its error would narrow the
    intervals of all others.
    """
    none = np.zeros((1, *transport.shape))
    spread = counts_spread(evaluation, transport, none, cell_spread)
    found = compare(evaluation, transport, spread, np.random.default_rng([seed, 4]))
    known = found.noise <= LOUD * found.spread
    if not known.any():
        return found
    colors = {name: getattr(found, name)[known] for name in ("error", "spread", "noise")}
    return replace(found, **colors)


def _joined(first: Comparison, second: Comparison) -> Comparison:
    """Return both together; each half foretells the other, so no score more is independent."""
    distinct = min(first.distinct, second.distinct)
    pairs = {
        name: np.concatenate([getattr(part, name) for part in (first, second)])
        for name in ("error", "spread", "noise", "score_error", "score_noise")
    }
    return Comparison(**pairs, distinct=distinct, noise_share=first.noise_share)


def _errors(evaluation: HeldOutEvaluation, name: str, transport: Array) -> HeldOutErrors:
    """Return the errors of ``transport``, with the tau of normal scores of their correlation.

    Few lamps have few designs, and many of these are the same but for the names of their colors:
    whichever of such a pair comes first is noise, and would be most of a tau of pairs.
    """
    off = [evaluation.scores(evaluation.counts(t)) for t in (transport, evaluation.reference)]
    off = [scores - scores.mean() for scores in off]
    norm = math.sqrt((off[0] ** 2).sum() * (off[1] ** 2).sum())
    # Scores that are all one agree with nothing.
    r = float((off[0] * off[1]).sum()) / norm if norm > 0.0 else 0.0
    tau = 2.0 / math.pi * math.asin(max(-1.0, min(r, 1.0)))
    return replace(evaluation.errors(name, transport), kendall_tau=tau)


def _mean_errors(found: list[HeldOutErrors]) -> HeldOutErrors:
    """Return the mean of both halves' errors, with the tau of the whole against the truth.

    Scores of halves that agree with the correlation r are, as a whole, right with
    ``sqrt(2 r / (1 + r))``; r and tau follow from each other by Greiner's (1909) formula.
    """
    names = [name for name in vars(found[0]) if name != "name"]
    mean = {name: float(np.mean([getattr(row, name) for row in found])) for name in names}
    r = math.sin(0.5 * math.pi * max(mean["kendall_tau"], 0.0))
    mean["kendall_tau"] = 2.0 / math.pi * math.asin(math.sqrt(2.0 * r / (1.0 + r)))
    return HeldOutErrors(**mean, name=TABLE)
