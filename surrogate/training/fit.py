"""Fitting the residual: ridge, then networks; the one that renders bear out is kept, or none.

Renders whose light paths are known in halves choose by `surrogate.training.halves`; for tables of
which only mean and error are known, the residual that is better out of fold is kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from torch import nn

from render.arrays import Array
from render.levels import NETWORK, PREVIEW, RIDGE
from render.progress import OnProgress
from render.steady_sums import steady_sums
from surrogate.model.facet_basis import SIZE
from surrogate.model.networks import NoResidual
from surrogate.runtime.metadata import NOISE, NONE
from surrogate.training.choose_residual import fit_ensembles, train_networks, train_ridge
from surrogate.training.conformal import (
    Comparison,
    Coverage,
    Quantiles,
    compare,
    conformal,
    counts_spread,
    coverage,
    fit_spread,
)
from surrogate.training.evaluation import HeldOutErrors, HeldOutEvaluation
from surrogate.training.fit_task import FitTask, Split, out_of_fold


@dataclass(frozen=True)
class Fit:
    """A fitted residual and everything that is known about its errors.

    Arguments:
        residual: the ensemble that goes into the graph.
        kind: ``ridge``, ``network``, ``table`` (see `surrogate.training.fit_table`), or ``none``
            where the renders bear none of them out.
        spread: parameters of the calibrated residual (see `CheckerModule`).
        quantiles: conformal factors from all held-out designs.
        coverage: what factors from one half of the cells cover of designs from the other half.
        levels: errors of preview, scaled preview, ridge and networks on held-out designs; of
            networks only where they are kept or chosen by these errors.
        splits: errors of the kept kind when whole fiber positions, directions or bends are out.
        unreliable, cells: number of cells with a relative error of half or more, and of all.
        noise: median relative standard error of the reference's cells.
        by_paths: errors and coverage are of models of one half of the light paths against the
            other half, instead of cells that members had not seen.
    """

    residual: nn.Module
    kind: str
    spread: tuple[float, float]
    quantiles: Quantiles
    coverage: Coverage | None
    levels: tuple[HeldOutErrors, ...]
    splits: tuple[HeldOutErrors, ...]
    unreliable: int
    cells: int
    noise: float
    by_paths: bool = False


@steady_sums()
def fit_residual(task: FitTask, progress: OnProgress | None) -> Fit:
    """Return the residual of ``task`` and all that is known about its errors."""
    cells, rows, evaluation = task.cells, task.rows, task.overall
    both = fit_ensembles(task, progress)
    preview = np.exp(rows.log_preview)
    factor = float((rows.weight * rows.ratio).sum() / rows.weight.sum())

    def errors(name: str, transport: Callable[[], Array], made: str = "") -> HeldOutErrors:
        return task.parts.value(
            f"held-out-{name}{made}", HeldOutErrors, lambda: evaluation.errors(name, transport())
        )

    levels = [
        errors(NOISE, lambda: rendered_again(task)),
        errors(PREVIEW, lambda: preview),
        errors(f"{PREVIEW}, one factor", lambda: preview * factor),
        errors(RIDGE, lambda: task.predicted(both.ridge)),
    ]
    if both.network is not None:
        network = both.network
        levels.append(errors(NETWORK, lambda: task.predicted(network), f"-{both.steps}"))
    kind = both.kind
    if kind is None:
        kind = NETWORK if levels[-1].facet_rms < levels[-2].facet_rms else RIDGE
    error = {row.name: row.facet_rms for row in levels}
    if kind != NONE and error[kind] > error[PREVIEW]:
        # Held-out cells flatter a residual, as they share light paths with those it was fitted to:
        # what makes designs worse even there is none. (Cells that the preview has next to black can
        # make it gain by cells.)
        kind = NONE
    model = {RIDGE: both.ridge, NETWORK: both.network, NONE: NoResidual(SIZE)}[kind]
    assert model is not None  # networks are kept only where they were trained
    # What the parts from here on are made of.
    made = f"{kind}-{both.steps}"

    def refit(split: Split, later: int) -> nn.Module:
        out, count = split.fold, split.members
        if kind == NETWORK:
            shorter = task.config.network.shorter(2)
            return train_networks(
                task, out, count, f"split by {split.name}", shorter, progress, later
            )[0]
        return train_ridge(task, f"ridge split by {split.name}", out, count, both.penalty)

    members = task.residuals(model)
    residual, deviation = out_of_fold(members, task.fold), members - members.mean(axis=0)
    b0, b1 = _spread(task, residual, deviation)
    cell_spread, transport = np.exp(b0 + b1 * rows.brightness), preview * np.exp(residual)

    def compared(evaluation: HeldOutEvaluation) -> Comparison:
        spread = counts_spread(evaluation, transport, deviation, cell_spread)
        found = compare(evaluation, transport, spread, np.random.default_rng([task.seed, 4]))
        # Cells are foretold out of fold: what these designs are off by is the model's own error.
        return replace(found, distinct=math.inf, noise_share=task.noise_share)

    return Fit(
        residual=model,
        kind=kind,
        spread=(b0, b1),
        quantiles=task.parts.value(
            f"quantiles-{made}",
            Quantiles,
            lambda: conformal(compared(evaluation), task.preview_half_width),
        ),
        coverage=_coverage(task, made, compared),
        levels=tuple(levels),
        splits=() if kind == NONE else _splits(task, made, refit),
        unreliable=int((~cells.reliable).sum()),
        cells=int(cells.reliable.size),
        noise=float(rows.noise.median()),
    )


def _splits(
    task: FitTask, made: str, refit: Callable[[Split, int], nn.Module]
) -> tuple[HeldOutErrors, ...]:
    """Return the errors when whole fiber positions, inner directions, bends or materials are out.

    ``refit`` takes a split and the number of those that follow, and returns an ensemble.
    """
    errors = []
    for number, split in enumerate(task.splits, start=1):

        def unseen(split: Split = split, later: int = len(task.splits) - number) -> HeldOutErrors:
            held_out = np.asarray(split.fold >= 0)
            residual = out_of_fold(task.residuals(refit(split, later)), split.fold)
            by_bend = split.name == "bend"
            bends = np.flatnonzero(held_out.any(axis=(0, 1))) if by_bend else task.bends
            designs = task.designs(np.asarray(held_out.any(axis=2)), 1)
            transport = np.exp(task.rows.log_preview + residual)
            evaluation = task.evaluation(designs, held_out, bends)
            return evaluation.errors(f"unseen {split.name}", transport)

        name = f"held-out-unseen {split.name}-{made}"
        errors.append(task.parts.value(name, HeldOutErrors, unseen))
    return tuple(errors)


def rendered_again(task: FitTask) -> Array:
    """Return the reference with its noise once more: what a perfect model's errors look like."""
    cells = task.cells
    random = task.overall.noise(np.random.default_rng([task.seed, 3]))
    return np.asarray(cells.transport + cells.error * random)


def _spread(task: FitTask, residual: Array, deviation: Array) -> tuple[float, float]:
    """Calibrate the cells' spread."""
    rows = task.rows
    predicted = np.exp(rows.log_preview + residual)
    return fit_spread(
        (task.cells.transport / predicted - 1.0).ravel(),
        (task.cells.error / predicted).ravel(),
        ((deviation**2).sum(axis=0) / max(len(deviation) - 1, 1)).ravel(),
        np.broadcast_to(rows.brightness[..., None], residual.shape).ravel(),
    )


def _coverage(
    task: FitTask, made: str, compared: Callable[[HeldOutEvaluation], Comparison]
) -> Coverage | None:
    """Return the coverage of designs whose cells had no part in the conformal factors.

    The pairs of fiber and direction are dealt to two halves like a chessboard (twins together);
    factors from designs of one half are tried on designs of the other, both ways.
    """
    cells, everywhere = task.cells, np.ones(task.cells.group.shape, dtype=bool)
    white = np.asarray((cells.fiber_group[..., 0] + cells.direction_group[..., 0]) % 2 == 0)

    def covered() -> Coverage:
        first, second = (
            compared(task.evaluation(task.designs(half, 2), everywhere, task.bends))
            for half in (white, ~white)
        )
        known = task.preview_half_width
        tried = (
            coverage(second, conformal(first, known)),
            coverage(first, conformal(second, known)),
        )
        counts, score = np.mean([(part.counts, part.score) for part in tried], axis=0).tolist()
        return Coverage(counts, score)

    return task.parts.value(f"coverage-{made}", Coverage, covered) if len(cells.phi) > 1 else None
