"""Fitting the residual: ridge, then networks; the one that is better out of fold is kept."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from torch import nn

from render.arrays import Array
from render.progress import Clock, OnProgress, in_stage
from render.scene import Scene
from surrogate.model.networks import RidgeEnsemble
from surrogate.model.preview_grid import PreviewGrid
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
from surrogate.training.dataset import (
    RegressionData,
    TrainingCells,
    build_rows,
    folds,
    interior_folds,
)
from surrogate.training.evaluation import (
    HeldOutEvaluation,
    LevelErrors,
    RandomDesigns,
    random_designs,
)
from surrogate.training.finished_parts import FinishedParts
from surrogate.training.fit_time import FitTime
from surrogate.training.mlp import NetworkConfig, fit_networks, one_thread
from surrogate.training.ridge import fit_ridge

VERSION = 1
"""Of the fit: finished parts of another one are made anew."""
SPLIT_FOLDS = 3
"""Folds when whole fiber positions, directions or bends are left out."""


@dataclass(frozen=True)
class FitConfig:
    """How the residual is fitted and evaluated.

    Arguments:
        members: folds of the cross-validation and members of the ensemble.
        network: size and training of the networks.
        penalties: candidate ridge penalties; the best out of fold is taken.
        designs: random held-out designs for errors and conformal factors.
    """

    members: int = 5
    network: NetworkConfig = field(default_factory=NetworkConfig)
    penalties: tuple[float, ...] = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
    designs: int = 300


@dataclass(frozen=True)
class Fit:
    """A fitted residual and everything that is known about its errors.

    Arguments:
        residual: the ensemble that goes into the graph.
        kind: ``ridge`` or ``network``.
        spread: parameters of the calibrated residual (see `CheckerModule`).
        quantiles: conformal factors from all held-out designs.
        coverage: what factors from one half of the cells cover of designs from the other half.
        levels: errors of preview, scaled preview, ridge and networks on held-out designs.
        splits: errors of the kept kind when whole fiber positions, directions or bends are out.
        unreliable, cells: number of cells with a relative error of half or more, and of all.
        noise: median relative standard error of the reference's cells.
    """

    residual: nn.Module
    kind: str
    spread: tuple[float, float]
    quantiles: Quantiles
    coverage: Coverage | None
    levels: tuple[LevelErrors, ...]
    splits: tuple[LevelErrors, ...]
    unreliable: int
    cells: int
    noise: float


@dataclass(frozen=True)
class Split:
    """Folds ``(direction, fiber, bend)`` that leave whole positions, directions ... out."""

    name: str
    fold: np.ndarray

    @property
    def members(self) -> int:
        """Number of folds."""
        return int(self.fold.max()) + 1


@dataclass(frozen=True)
class FitTask:
    """What is fitted: the residual of ``cells`` on the preview ``grid``.

    Arguments:
        scene, grid, cells: the sensor, its preview and its training cells.
        exposure, lam: of the scene.
        bends: indices of the bends that designs are evaluated at.
        seed: of folds, networks and held-out designs; the same seed gives the same fit.
        config: how it is fitted.
        time: what the networks' steps have to fit into; all of them without.
        folder: where finished parts are kept, so that a fit goes on; None keeps none.
    """

    scene: Scene
    grid: PreviewGrid
    cells: TrainingCells
    exposure: float
    lam: float
    bends: np.ndarray
    seed: int
    config: FitConfig
    time: FitTime | None = None
    folder: Path | None = None

    @cached_property
    def parts(self) -> FinishedParts:
        """What is finished of it."""
        digest = hashlib.sha256()
        for array in (self.cells.transport, self.cells.error, self.grid.log_transport, self.bends):
            digest.update(np.ascontiguousarray(array).tobytes())
        versions = torch.__version__, np.__version__, VERSION
        about = self.scene.hash, self.exposure, self.lam, self.seed, self.config, versions
        digest.update(repr(about).encode())
        return FinishedParts(self.folder, digest.hexdigest())

    @cached_property
    def rows(self) -> RegressionData:
        """The regression rows of the cells."""
        return build_rows(self.scene, self.grid, self.cells)

    @cached_property
    def fold(self) -> np.ndarray:
        """``(direction, fiber, bend)`` fold of every cell."""
        return folds(self.cells.group, self.config.members, self.seed)

    @cached_property
    def splits(self) -> tuple[Split, ...]:
        """Folds of whole fiber positions, inner directions, bends and materials, where several."""
        cells = self.cells
        groups = (
            ("fiber position", cells.fiber_group, False),
            ("direction", cells.direction_group, True),
            ("bend", cells.bend_group, True),
            ("material", cells.material_group, False),
        )
        splits = (
            Split(name, interior_folds(group, SPLIT_FOLDS, self.seed, inner))
            for name, group, inner in groups
        )
        return tuple(split for split in splits if split.members > 1)

    @cached_property
    def overall(self) -> HeldOutEvaluation:
        """Held-out designs over all cells."""
        everywhere = np.ones(self.fold.shape, dtype=bool)
        return self.evaluation(self.designs(everywhere[..., 0], 0), everywhere, self.bends)

    def evaluation(
        self, designs: RandomDesigns, held_out: np.ndarray, bends: np.ndarray
    ) -> HeldOutEvaluation:
        """Return the evaluation of ``designs`` on cells ``held_out`` at some bends."""
        return HeldOutEvaluation(
            reference=self.cells.transport,
            error=self.cells.error,
            reliable=self.cells.reliable,
            designs=designs,
            exposure=self.exposure,
            lam=self.lam,
            held_out=held_out,
            bends=bends,
        )

    def designs(self, allowed: np.ndarray, stream: int) -> RandomDesigns:
        """Return random designs over the directions ``allowed`` ``(direction, fiber)``."""
        rng = np.random.default_rng([self.seed, stream])
        count, block = self.config.designs, self.cells.block
        return random_designs(count, allowed, block, rng, self.scene.palette)

    def residuals(self, model: nn.Module) -> Array:
        """Return what every member adds to the log preview, ``(member, ...)``."""
        with torch.no_grad():
            return self.rows.residuals(model(self.rows.x))

    def predicted(self, model: nn.Module) -> Array:
        """Return the transport that members predict out of fold."""
        residual = out_of_fold(self.residuals(model), self.fold)
        return np.asarray(np.exp(self.rows.log_preview) * np.exp(residual))


@one_thread()
def fit_ensembles(task: FitTask, progress: OnProgress | None) -> dict[str, nn.Module]:
    """Return ``ridge`` and ``network`` as :func:`fit_residual` fits them, without evaluation."""
    both = _ensembles(task, progress)
    return {"ridge": both.ridge, "network": both.network}


@one_thread()
def fit_residual(task: FitTask, progress: OnProgress | None) -> Fit:
    """Return the residual of ``task`` and all that is known about its errors."""
    cells, rows, evaluation = task.cells, task.rows, task.overall
    both = _ensembles(task, progress)
    preview = np.exp(rows.log_preview)
    factor = float((rows.weight * rows.ratio).sum() / rows.weight.sum())

    def errors(level: str, transport: Callable[[], Array], made: str = "") -> LevelErrors:
        return task.parts.value(
            f"errors-{level}{made}", LevelErrors, lambda: evaluation.errors(level, transport())
        )

    levels = (
        errors("noise of the reference", lambda: _noisy(task)),
        errors("preview", lambda: preview),
        errors("preview, one factor", lambda: preview * factor),
        errors("ridge", lambda: task.predicted(both.ridge)),
        errors("network", lambda: task.predicted(both.network), f"-{both.steps}"),
    )
    better = levels[-1].facet_rms < levels[-2].facet_rms
    kind, model = ("network", both.network) if better else ("ridge", both.ridge)
    # What the parts from here on are made of.
    made = f"{kind}-{both.steps}"

    def refit(split: Split, later: int) -> nn.Module:
        out, count = split.fold, split.members
        if better:
            shorter = task.config.network.shorter(2)
            return _train(task, out, count, f"split by {split.name}", shorter, progress, later)[0]
        return _ridge(task, f"ridge split by {split.name}", out, count, both.penalty)

    members = task.residuals(model)
    residual, deviation = out_of_fold(members, task.fold), members - members.mean(axis=0)
    b0, b1 = _spread(task, residual, deviation)
    cell_spread, transport = np.exp(b0 + b1 * rows.brightness), preview * np.exp(residual)

    def compared(evaluation: HeldOutEvaluation) -> Comparison:
        spread = counts_spread(evaluation, transport, deviation, cell_spread)
        return compare(evaluation, transport, spread, np.random.default_rng([task.seed, 4]))

    return Fit(
        residual=model,
        kind=kind,
        spread=(b0, b1),
        quantiles=task.parts.value(
            f"quantiles-{made}", Quantiles, lambda: conformal(compared(evaluation))
        ),
        coverage=_coverage(task, made, compared),
        levels=levels,
        splits=_splits(task, made, refit),
        unreliable=int((~cells.reliable).sum()),
        cells=int(cells.reliable.size),
        noise=float(rows.noise.median()),
    )


@dataclass(frozen=True)
class _Ensembles:
    """Ridge with the penalty that is best out of fold, and networks with their steps."""

    penalty: float
    ridge: nn.Module
    network: nn.Module
    steps: int


def _ensembles(task: FitTask, progress: OnProgress | None) -> _Ensembles:
    config, fold, overall = task.config, task.fold, task.overall
    clock, ridges = Clock(len(config.penalties), progress, "ridge"), []
    for penalty in config.penalties:
        name = f"ridge-{penalty:g}"
        model = _ridge(task, name, fold, config.members, penalty)
        found = task.parts.value(
            f"errors-{name}",
            LevelErrors,
            lambda model=model: overall.errors("ridge", task.predicted(model)),  # type: ignore[misc]
        )
        ridges.append((found.facet_rms, penalty, model))
        clock.tick()
    _, penalty, ridge = min(ridges, key=lambda item: item[0])
    splits = len(task.splits)
    network, steps = _train(
        task, fold, config.members, "networks", config.network, progress, splits
    )
    return _Ensembles(penalty, ridge, network, steps)


def _train(
    task: FitTask,
    where: np.ndarray,
    members: int,
    name: str,
    network: NetworkConfig,
    progress: OnProgress | None,
    later: int,
) -> tuple[nn.Module, int]:
    """Return networks and steps; where time decides these, ``later`` splits need some of it too."""
    steps, told = network.steps, in_stage(progress, name)
    if task.time is not None:
        steps = task.time.steps(name, network.steps, members=members, splits=later)
    network, part = replace(network, steps=steps), f"{name}-{steps}"
    fresh, began = task.parts.load(part) is None, time.monotonic()
    made = fit_networks(task.rows, where, members, network, task.seed, told, task.parts, part)
    if task.time is not None and fresh:
        task.time.took(steps, members, time.monotonic() - began)
    return made, steps


def _ridge(
    task: FitTask, name: str, where: np.ndarray, members: int, penalty: float
) -> RidgeEnsemble:
    def fit() -> dict[str, np.ndarray]:
        return {"weight": fit_ridge(task.rows, where, members, penalty).weight.numpy()}

    kept = task.parts.arrays(name, fit)
    return RidgeEnsemble(torch.tensor(kept["weight"]), task.rows.x.shape[1])


def out_of_fold(residuals: Array, fold: np.ndarray) -> Array:
    """Return, for every cell, the residual of the member that was trained without it.

    Arguments:
        residuals: ``(member, direction, fiber, bend, site, normal)``; member ``m`` was trained
            without fold ``m``.
        fold: ``(direction, fiber, bend)``; -1 where no member was held out (the mean is taken).
    """
    out = residuals.mean(axis=0)
    for member, residual in enumerate(residuals):
        out[fold == member] = residual[fold == member]
    return np.asarray(out)


def _splits(
    task: FitTask, made: str, refit: Callable[[Split, int], nn.Module]
) -> tuple[LevelErrors, ...]:
    """Return the errors when whole fiber positions, inner directions, bends or materials are out.

    ``refit`` takes a split and the number of those that follow, and returns an ensemble.
    """
    errors = []
    for number, split in enumerate(task.splits, start=1):

        def unseen(split: Split = split, later: int = len(task.splits) - number) -> LevelErrors:
            held_out = np.asarray(split.fold >= 0)
            residual = out_of_fold(task.residuals(refit(split, later)), split.fold)
            by_bend = split.name == "bend"
            bends = np.flatnonzero(held_out.any(axis=(0, 1))) if by_bend else task.bends
            designs = task.designs(np.asarray(held_out.any(axis=2)), 1)
            transport = np.exp(task.rows.log_preview + residual)
            evaluation = task.evaluation(designs, held_out, bends)
            return evaluation.errors(f"unseen {split.name}", transport)

        errors.append(task.parts.value(f"errors-unseen {split.name}-{made}", LevelErrors, unseen))
    return tuple(errors)


def _noisy(task: FitTask) -> Array:
    """Return the reference with its noise once more: what a perfect model's errors look like."""
    cells = task.cells
    random = np.random.default_rng([task.seed, 3]).standard_normal(cells.error.shape)
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
        tried = coverage(second, conformal(first)), coverage(first, conformal(second))
        counts, score = np.mean([(part.counts, part.score) for part in tried], axis=0).tolist()
        return Coverage(counts, score)

    return task.parts.value(f"coverage-{made}", Coverage, covered) if len(cells.phi) > 1 else None
