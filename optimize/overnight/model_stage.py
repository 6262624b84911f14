"""The surrogate of the night: fitted to the night's own table, as long as its share of time allows.

A model that is whole and was logged is not fitted again; a damaged one is, and comes out the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from optimize.overnight.budget import FIT_STEPS, MODEL_UNTIL
from optimize.overnight.context import RunContext
from optimize.overnight.store import TABLE
from render.errors import ModelError
from render.transport import TransportTable
from surrogate.runtime.checker import Checker
from surrogate.runtime.model_file import MODEL_FILE, sha256

MODEL = "model"
TRIAL_STEPS = 60
HELD_OUT_FACTOR = 1.9
"""The networks for held-out fibers, directions and bends take about this many times the steps."""
FIT_OVERHEAD_SECONDS = 30.0
"""Seconds of a fit around the networks: the preview's grid, ridge, errors, export."""


def fit_model(context: RunContext, table: Callable[[], TransportTable]) -> Checker:
    """Return the surrogate that is fitted to ``table``, which is read only where it is needed."""
    folder = context.store.run / MODEL
    known = context.decided("model")
    if known is not None:
        found = _whole(context, known["sha256"])
        if found is not None:
            return found
        context.log.note(f"{folder} is missing or damaged: the surrogate is fitted again")
        for item in folder.glob("*") if folder.is_dir() else ():
            item.unlink()
    from surrogate.training.train import TrainConfig, TrainProgress, train

    context.stage("Surrogate", "surrogate")
    steps = context.decide("fit", lambda: {"steps": _steps(context, table())})["steps"]
    config = TrainConfig()
    network = replace(config.fit.network, steps=steps)

    def progress(state: TrainProgress) -> None:
        eta = None if np.isnan(state.eta_seconds) else state.eta_seconds
        context.show(state.done, state.total, eta)

    began = time.monotonic()
    train(
        # The table is of the scene's own material, whatever it leaves free.
        context.scene.model_copy(update={"free": None}),
        folder,
        seed=context.seed,
        table=table(),
        run=context.store.run / TABLE,
        config=replace(config, fit=replace(config.fit, network=network)),
        command=f"tactilux overnight {context.scene.name} --seed {context.seed}",
        progress=progress,
    )
    digest = sha256((folder / MODEL_FILE).read_bytes())
    context.decide("model", lambda: {"sha256": digest, "seconds": time.monotonic() - began})
    made = _whole(context, context.decided("model")["sha256"])
    if made is None:
        raise ModelError(
            f"{folder} was fitted again to the same renders and came out different: this is "
            "another processor type or another version; start anew in another directory",
            field="model",
        )
    return made


def _whole(context: RunContext, digest: str) -> Checker | None:
    """Return the model in the run directory if it is the one of that SHA-256."""
    folder = context.store.run / MODEL
    try:
        if sha256((folder / MODEL_FILE).read_bytes()) != digest:
            return None
        return Checker.load(folder, context.scene.hash)
    except (OSError, ModelError):
        return None


def _steps(context: RunContext, table: TransportTable) -> int:
    """Return the steps that fit the time, after timing a few on data of the same size."""
    if context.fixed is not None:
        return context.fixed.fit_steps
    low, high = FIT_STEPS
    per_step = HELD_OUT_FACTOR * _seconds_per_step(table)
    free = context.seconds_until(MODEL_UNTIL) - FIT_OVERHEAD_SECONDS
    return min(high, max(low, int(free / per_step)))


def _seconds_per_step(table: TransportTable) -> float:
    import torch

    from surrogate.model.facet_basis import SIZE
    from surrogate.model.features import INPUT_NAMES
    from surrogate.training.fit import FitConfig
    from surrogate.training.mlp import fit_networks
    from surrogate.training.regression import Rows

    config = FitConfig()
    directions, count = len(table.phi), config.network.batch
    shape = (directions, count, 1, 1)
    rows = directions * count
    normals = table.T.shape[4] + 1
    data = Rows(
        x=torch.zeros(rows, len(INPUT_NAMES)),
        basis=torch.zeros(rows, SIZE, normals),
        ratio=torch.ones(rows, normals),
        noise=torch.ones(rows, normals),
        log_preview=np.zeros((*shape, normals)),
    )
    fold = np.arange(directions * count).reshape(shape[:3]) % config.members
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        seconds = []
        # The first fit of a process takes seconds longer than any other.
        for steps in (1, 1, TRIAL_STEPS):
            began = time.monotonic()
            network = replace(config.network, steps=steps)
            fit_networks(data, fold, config.members, network, 0)
            seconds.append(time.monotonic() - began)
    finally:
        torch.set_num_threads(threads)
    return max(seconds[2] - seconds[1], 1e-4) / (TRIAL_STEPS - 1)
