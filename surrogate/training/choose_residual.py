"""Ridge and networks on the rows of a fit, and which of them the renders bear out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import nn

from render.arrays import Array
from render.levels import NETWORK, RIDGE
from render.progress import Clock, OnProgress, in_stage
from render.steady_sums import steady_sums
from surrogate.model.networks import RidgeEnsemble
from surrogate.runtime.metadata import NONE
from surrogate.training.dataset import RegressionData
from surrogate.training.evaluation import HeldOutErrors
from surrogate.training.fit_task import FitTask
from surrogate.training.halves import borne_out, mean_gains
from surrogate.training.mlp import NetworkConfig, fit_networks
from surrogate.training.ridge import fit_ridge


@dataclass(frozen=True)
class Ensembles:
    """Ridge with the best penalty, networks with their steps, and which is kept.

    ``kind`` None leaves that to their errors out of fold; ``network`` is None where the renders
    bear none out.
    """

    penalty: float
    ridge: nn.Module
    network: nn.Module | None
    steps: int
    kind: str | None = None


@steady_sums()
def fit_ensembles(task: FitTask, progress: OnProgress | None) -> Ensembles:
    """Return what is fitted to all cells, by halves of the light paths where those are known."""
    return (_by_folds if task.rows.half_difference is None else _by_halves)(task, progress)


def _by_folds(task: FitTask, progress: OnProgress | None) -> Ensembles:
    config, fold, overall = task.config, task.fold, task.overall
    clock, ridges = Clock(len(config.penalties), progress, "ridge"), []
    for penalty in config.penalties:
        name = f"ridge-{penalty:g}"
        model = train_ridge(task, name, fold, config.members, penalty)
        found = task.parts.value(
            f"held-out-{name}",
            HeldOutErrors,
            lambda model=model: overall.errors(RIDGE, task.predicted(model)),  # type: ignore[misc]
        )
        ridges.append((found.facet_rms, penalty, model))
        clock.tick()
    _, penalty, ridge = min(ridges, key=lambda item: item[0])
    splits = len(task.splits)
    network, steps = train_networks(
        task, fold, config.members, "networks", config.network, progress, splits
    )
    return Ensembles(penalty, ridge, network, steps)


def _by_halves(task: FitTask, progress: OnProgress | None) -> Ensembles:
    config, rows, everywhere = task.config, task.rows, np.full(task.fold.shape, -1)

    def gains(name: str, fitted: Callable[[RegressionData, int], nn.Module]) -> Array:
        def residual(half: RegressionData, number: int) -> Array:
            model = fitted(half, number)
            with torch.no_grad():
                return np.asarray(half.residuals(model(half.x))[0])

        made = task.parts.arrays(f"gains-{name}", lambda: {name: mean_gains(rows, residual)})
        return np.asarray(made[name], dtype=np.float64)

    clock, found = Clock(len(config.penalties), progress, "ridge"), {}
    for penalty in config.penalties:
        found[penalty] = gains(
            f"ridge-{penalty:g}",
            lambda half, _, penalty=penalty: fit_ridge(half, everywhere, 1, penalty),  # type: ignore[misc]
        )
        clock.tick()
    penalty = max(found, key=lambda each: float(found[each].mean()))
    ridge = train_ridge(task, f"ridge-{penalty:g}", task.fold, config.members, penalty)
    copies, kind, gain = len(task.scene.albedos), NONE, 0.0
    if borne_out(found[penalty], copies, len(found)):
        kind, gain = RIDGE, found[penalty].mean()
    if not task.networks:
        return Ensembles(penalty, ridge, None, 0, kind)
    # Those on halves take about as long as a split.
    steps = _steps(task, "networks", config.members, config.network, len(task.splits) + 1)
    told = in_stage(progress, "networks on halves")
    short = replace(config.network, steps=max(1, steps // 2))
    by_networks = gains(
        f"networks-{steps}",
        lambda half, number: fit_networks(
            half, everywhere, 1, short, task.seed, told, task.parts, f"half-{number}-{steps}"
        ),
    )
    if not (borne_out(by_networks, copies) and by_networks.mean() > gain):
        return Ensembles(penalty, ridge, None, steps, kind)
    network, _ = train_networks(
        task, task.fold, config.members, "networks", config.network, progress, len(task.splits)
    )
    return Ensembles(penalty, ridge, network, steps, NETWORK)


def train_networks(
    task: FitTask,
    where: np.ndarray,
    members: int,
    name: str,
    network: NetworkConfig,
    progress: OnProgress | None,
    later: int,
) -> tuple[nn.Module, int]:
    """Return networks and steps; where time decides these, ``later`` splits need some of it too."""
    told, steps = in_stage(progress, name), _steps(task, name, members, network, later)
    network, part = replace(network, steps=steps), f"{name}-{steps}"
    fresh, began = task.parts.load(part) is None, time.monotonic()
    made = fit_networks(task.rows, where, members, network, task.seed, told, task.parts, part)
    if task.time is not None and fresh:
        task.time.took(steps, members, time.monotonic() - began)
    return made, steps


def _steps(task: FitTask, name: str, members: int, network: NetworkConfig, later: int) -> int:
    """Return the steps of the networks ``name``: all, or what the time allows."""
    if task.time is None:
        return network.steps
    return task.time.steps(name, network.steps, members=members, splits=later)


def train_ridge(
    task: FitTask, name: str, where: np.ndarray, members: int, penalty: float
) -> RidgeEnsemble:
    """Return the ridges ``name`` with one penalty; member ``m`` does not see fold ``m``."""

    def fit() -> dict[str, np.ndarray]:
        return {"weight": fit_ridge(task.rows, where, members, penalty).weight.numpy()}

    kept = task.parts.arrays(name, fit)
    return RidgeEnsemble(torch.tensor(kept["weight"]), task.rows.x.shape[1])
