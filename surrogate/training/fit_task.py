"""What is fitted: the residual of rendered cells on a preview, and how it is held out."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from torch import nn

from render.arrays import Array
from render.finished_parts import FinishedParts
from render.noise_share import noise_share
from render.scene import Scene
from surrogate.model.lamp_copies import copied, split_power
from surrogate.model.preview_grid import PreviewGrid
from surrogate.training.dataset import (
    RegressionData,
    TrainingCells,
    build_rows,
    folds,
    interior_folds,
)
from surrogate.training.evaluation import HeldOutEvaluation, RandomDesigns, random_designs
from surrogate.training.fit_time import FitTime
from surrogate.training.mlp import NetworkConfig

VERSION = 6
"""Of the fit: finished parts of another one are made anew."""
SPLIT_FOLDS = 3
"""Folds when whole fiber positions, directions or bends are left out."""


@dataclass(frozen=True)
class FitConfig:
    """How the residual is fitted and evaluated.

    Arguments:
        members: folds of the cross-validation and members of the ensemble.
        network: size and training of the networks.
        penalties: candidate ridge penalties; the best is taken.
        designs: random held-out designs for errors and conformal factors.
    """

    members: int = 5
    network: NetworkConfig = field(default_factory=NetworkConfig)
    penalties: tuple[float, ...] = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)
    designs: int = 300


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
        networks: whether they are tried.
        preview_half_width: of the interval of scores of the preview, counts; None where it is not
            known.
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
    networks: bool = True
    preview_half_width: float | None = None

    @cached_property
    def parts(self) -> FinishedParts:
        """What is finished of it."""
        digest = hashlib.sha256()
        cells = self.cells
        halves = [] if cells.half_difference is None else [cells.half_difference]
        given = cells.transport, cells.error, *halves, self.grid.log_transport, self.bends
        for array in given:
            digest.update(np.ascontiguousarray(array).tobytes())
        versions = torch.__version__, np.__version__, VERSION
        scale = self.exposure, self.lam, self.preview_half_width
        about = self.scene.hash, *scale, self.seed, self.config, versions
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
        """Folds of whole fiber positions, inner directions, bends and materials, where several.

        A named state is no value between others, so that none is left out.
        """
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
            if name != "bend" or self.scene.states is None
        )
        return tuple(split for split in splits if split.members > 1)

    @cached_property
    def overall(self) -> HeldOutEvaluation:
        """Held-out designs over all cells."""
        everywhere = np.ones(self.fold.shape, dtype=bool)
        return self.evaluation(self.designs(everywhere[..., 0], 0), everywhere, self.bends)

    @cached_property
    def noise_share(self) -> float:
        """Share of noise in what facets of the renders differ by, root mean square over designs.

        The noise is what halves of the light paths differ by; where those are unknown it is drawn
        from the error bars.
        """
        cells, held = self.cells, self.overall
        off = cells.half_difference
        if off is None:
            off = cells.error * held.noise(np.random.default_rng([self.seed, 5]))
        halves = np.stack(
            [
                held.designs.transport(half[:, :, self.bends, :, :-1])
                for half in (cells.transport + off, cells.transport - off)
            ],
            axis=1,
        )
        shares = [
            noise_share(light, power, self.exposure)
            for light, power in zip(halves, held.designs.power, strict=True)
        ]
        return float(np.sqrt(np.mean(np.square(shares))))

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
            copies=len(self.scene.albedos),
        )

    def designs(self, allowed: np.ndarray, stream: int) -> RandomDesigns:
        """Return random designs over the directions ``allowed`` ``(direction, fiber)``."""
        rng, scene = np.random.default_rng([self.seed, stream]), self.scene
        count, block = self.config.designs, self.cells.block
        drawn = random_designs(count, allowed[:, : scene.lamp_count], block, rng, scene.palette)
        return RandomDesigns(
            copied(scene, drawn.direction, axis=1), split_power(scene, drawn.power)
        )

    def residuals(self, model: nn.Module) -> Array:
        """Return what every member adds to the log preview, ``(member, ...)``."""
        with torch.no_grad():
            return self.rows.residuals(model(self.rows.x))

    def predicted(self, model: nn.Module) -> Array:
        """Return the transport that members predict out of fold."""
        residual = out_of_fold(self.residuals(model), self.fold)
        return np.asarray(np.exp(self.rows.log_preview) * np.exp(residual))


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
