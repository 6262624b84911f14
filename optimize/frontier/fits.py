"""Preview + ridge and preview + network, fitted to a reference table as ``tactilux train`` does."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import nn

from optimize.frontier.levels import Level
from render.arrays import Array
from render.files import read_npz, write_npz
from render.scene.schema import Scene
from render.transport import TransportTable
from surrogate.model.checker_module import Checker as Graph
from surrogate.model.features import INPUT_NAMES
from surrogate.model.networks import NetworkEnsemble, RidgeEnsemble
from surrogate.model.preview_grid import PreviewGrid
from surrogate.training.dataset import cells_from_table
from surrogate.training.evaluation import scene_bends
from surrogate.training.fit import FitConfig, fit_ensembles
from surrogate.training.reference_data import data_hash

NAMES = {"ridge": "preview + ridge", "network": "preview + network"}


def fitted_levels(
    scene: Scene,
    grid: PreviewGrid,
    table: TransportTable,
    *,
    exposure: float,
    lam: float,
    seed: int,
    config: FitConfig,
    folder: Path,
    progress: Callable[[str, int, int], None],
) -> list[Level]:
    """Return both levels; what was fitted before to the same data lies in ``folder``."""
    began = time.perf_counter()
    digest = hashlib.sha256(grid.log_transport.tobytes())
    digest.update(f"{data_hash(table)} {seed} {config}".encode())
    path = folder / f"fits-{digest.hexdigest()[:16]}.npz"
    if path.exists():
        models, spent = _load(path)
    else:
        models = fit_ensembles(
            scene,
            grid,
            cells_from_table(scene, table),
            exposure=exposure,
            lam=lam,
            bends=scene_bends(table, scene.bending.angles),
            seed=seed,
            config=config,
            progress=progress,
        )
        spent = time.perf_counter() - began
        _save(path, models, spent)
    bends = torch.tensor([scene.bending.angles], dtype=torch.float32)

    def level(name: str) -> Level:
        graph = Graph(scene, grid, models[name], exposure=exposure, lam=lam, spread=(-3.0, 0.0))

        def counts(phi: Array, power: Array) -> Array:
            with torch.no_grad():
                found = graph(
                    torch.as_tensor(phi, dtype=torch.float32),
                    torch.as_tensor(power, dtype=torch.float32),
                    bends.expand(len(phi), -1),
                )
            return np.asarray(found.counts.double().numpy())

        return Level(NAMES[name], counts, spent, note="in torch, on the preview's table")

    return [level("ridge"), level("network")]


def _save(path: Path, models: dict[str, nn.Module], seconds: float) -> None:
    arrays = {
        f"{name}.{key}": value.numpy()
        for name, model in models.items()
        for key, value in model.state_dict().items()
    }
    write_npz(path, arrays | {"seconds": np.array(seconds)})


def _load(path: Path) -> tuple[dict[str, nn.Module], float]:
    arrays = read_npz(path)
    members, _, outputs = arrays["network.weight3"].shape
    width = arrays["network.weight2"].shape[1]
    inputs = len(INPUT_NAMES)
    models: dict[str, nn.Module] = {
        "ridge": RidgeEnsemble(torch.as_tensor(arrays["ridge.weight"]), inputs),
        "network": NetworkEnsemble(members, inputs, width, outputs, torch.Generator()),
    }
    for name, model in models.items():
        model.load_state_dict(
            {key: torch.as_tensor(arrays[f"{name}.{key}"]) for key in model.state_dict()}
        )
    return models, float(arrays["seconds"])
