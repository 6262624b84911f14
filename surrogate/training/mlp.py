"""The trained residual: an ensemble of small perceptrons, all members in one batched descent."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from render.finished_parts import NOTHING_KEPT, FinishedParts
from render.progress import Clock, OnProgress
from render.steady_sums import steady_sums
from surrogate.model.facet_basis import SIZE
from surrogate.model.features import FEATURE_NAMES
from surrogate.model.networks import NetworkEnsemble
from surrogate.training.dataset import RegressionData, expand

SAVE_SECONDS = 2.0
"""Between states that are kept of networks in training."""
MOMENTS = ("exp_avg", "exp_avg_sq")
"""What Adam keeps of every weight."""
TRIAL_STEPS = 60
"""Steps that are timed, to see how long one takes."""


@dataclass(frozen=True)
class NetworkConfig:
    """Size and training of the networks.

    Arguments:
        width: units per hidden layer.
        steps: steps of Adam; batch: rows per step.
        rate: largest learning rate, reached after a short warm-up, then a cosine to 0.
        decay: decoupled weight decay (Loshchilov and Hutter 2019).
    """

    width: int = 32
    steps: int = 10000
    batch: int = 512
    rate: float = 1e-2
    decay: float = 1e-4

    def shorter(self, factor: int) -> NetworkConfig:
        """Return the same with fewer steps."""
        return replace(self, steps=max(1, self.steps // factor))


def fit_networks(
    rows: RegressionData,
    fold: np.ndarray,
    members: int,
    config: NetworkConfig,
    seed: int,
    progress: OnProgress | None = None,
    parts: FinishedParts = NOTHING_KEPT,
    name: str = "networks",
) -> NetworkEnsemble:
    """Return ``members`` networks; member ``m`` does not see the rows of fold ``m``.

    Minimizes the weighted gamma deviance (:func:`deviance`).
    ``progress`` is told of every 100 steps. ``parts`` keeps weights, moments of Adam, random state
    and the rows still to come as ``name``, every ``SAVE_SECONDS`` and at the end; there it goes on.
    """
    generator = torch.Generator().manual_seed(seed)
    outputs = rows.basis.shape[1]
    net = NetworkEnsemble(members, rows.x.shape[1], config.width, outputs, generator)
    optimizer = torch.optim.AdamW(net.parameters(), lr=config.rate, weight_decay=config.decay)
    index = rows.fold_rows(fold)
    seen = (index[None] != torch.arange(members)[:, None]).float()
    weight = seen[..., None] * rows.weight
    weight = weight / weight.mean(dim=(1, 2), keepdim=True)
    order = torch.zeros(0, dtype=torch.long)
    clock, begin, saved = Clock(config.steps, progress), 0, time.monotonic()
    kept = parts.load(name)
    if kept is not None:
        begin, order = _restore(net, optimizer, generator, kept)
        clock.skip(begin)
    for step in range(begin, config.steps):
        if time.monotonic() - saved > SAVE_SECONDS:
            parts.save(name, _state(net, optimizer, generator, order, step))
            saved = time.monotonic()
        for group in optimizer.param_groups:
            group["lr"] = config.rate * _rate(step, config.steps)
        if len(order) < config.batch:
            order = torch.cat([order, torch.randperm(len(rows.x), generator=generator)])
        take, order = order[: config.batch], order[config.batch :]
        residual = expand(net(rows.x[take]), rows.basis[take])
        error = deviance(rows.ratio[take], residual)
        loss = (weight[:, take] * error).mean(dim=(1, 2)).sum()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        if (step + 1) % 100 == 0:
            clock.tick(100)
    if begin < config.steps:
        parts.save(name, _state(net, optimizer, generator, order, config.steps))
    return net


def _state(
    net: NetworkEnsemble,
    optimizer: torch.optim.AdamW,
    generator: torch.Generator,
    order: Tensor,
    step: int,
) -> dict[str, np.ndarray]:
    """Return all that the steps from ``step`` on depend on."""
    state = {"step": np.array(step), "order": order.numpy(), "rng": generator.get_state().numpy()}
    for name, weight in net.named_parameters():
        state[name] = weight.detach().numpy()
        for moment in MOMENTS if step else ():
            state[f"{name}.{moment}"] = optimizer.state[weight][moment].numpy()
    return state


def _restore(
    net: NetworkEnsemble,
    optimizer: torch.optim.AdamW,
    generator: torch.Generator,
    state: dict[str, np.ndarray],
) -> tuple[int, Tensor]:
    """Take up what `_state` returned; return its step and the rows still to come."""
    step = int(state["step"])
    generator.set_state(torch.tensor(state["rng"]))
    for name, weight in net.named_parameters():
        weight.data.copy_(torch.tensor(state[name]))
        if step:
            moments = {moment: torch.tensor(state[f"{name}.{moment}"]) for moment in MOMENTS}
            optimizer.state[weight] = {"step": torch.tensor(float(step)), **moments}
    return step, torch.tensor(state["order"])


def seconds_per_step(directions: int, normals: int, members: int, config: NetworkConfig) -> float:
    """Return the seconds of a step of `fit_networks` here, by timing some on invented rows.

    ``directions`` of the table set how many rows there are, with ``normals`` each.
    """
    rows, shape = directions * config.batch, (directions, config.batch, 1)
    data = RegressionData(
        x=torch.zeros(rows, len(FEATURE_NAMES)),
        basis=torch.zeros(rows, SIZE, normals),
        ratio=torch.ones(rows, normals),
        noise=torch.ones(rows, normals),
        log_preview=np.zeros((*shape, 1, normals)),
    )
    fold = np.arange(rows).reshape(shape) % members
    spent = []
    with steady_sums():
        # The first fit of a process takes seconds longer than any other.
        for steps in (1, 1, TRIAL_STEPS):
            began = time.monotonic()
            fit_networks(data, fold, members, replace(config, steps=steps), 0)
            spent.append(time.monotonic() - began)
    return max(spent[2] - spent[1], 1e-4) / (TRIAL_STEPS - 1)


def deviance(ratio: Tensor, residual: Tensor) -> Tensor:
    """Return the gamma deviance ``y exp(-r) + r`` of every cell, up to a constant.

    ``y`` is T_reference / T_preview and ``r`` the residual. Its minimum over noisy ``y`` is
    log E[y], whatever the noise (McCullagh and Nelder 1989, 8.3), where least squares in log y
    would be biased by -variance / 2 and could not use cells that came out as 0.
    """
    return ratio * torch.exp(-residual) + residual


def _rate(step: int, steps: int) -> float:
    """Return the factor of the learning rate: linear warm-up over 2 %, then half a cosine."""
    warm = max(1, steps // 50)
    if step < warm:
        return (step + 1) / warm
    return 0.5 * (1 + math.cos(math.pi * (step - warm) / max(1, steps - warm)))
