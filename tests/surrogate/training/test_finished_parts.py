"""A fit that is ended at any instant goes on from its finished parts and ends bit-equal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from render.finished_parts import FinishedParts
from render.progress import Progress
from render.scene import Scene
from render.transport import TransportTable
from surrogate.model.preview_grid import PreviewGrid
from surrogate.training.dataset import RegressionData, build_rows, folds, training_cells
from surrogate.training.fit import Fit, fit_residual
from surrogate.training.fit_task import FitConfig, FitTask
from surrogate.training.mlp import NetworkConfig, fit_networks

SHORT = NetworkConfig(width=8, steps=300, batch=256)


class Ended(Exception):
    """The process was killed, as far as a fit can tell."""


class EndsAfter:
    """Progress that ends the work when it is told for the ``count``-th time."""

    def __init__(self, count: int) -> None:
        self.count = count

    def __call__(self, at: Progress) -> None:
        self.count -= 1
        if self.count < 0:
            raise Ended


@pytest.fixture(autouse=True)
def _saves_at_every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("surrogate.training.mlp.SAVE_SECONDS", 0.0)


@pytest.fixture(scope="module")
def rows(scene: Scene, grid: PreviewGrid, reference: TransportTable) -> RegressionData:
    return build_rows(scene, grid, training_cells(scene, [reference]))


@pytest.fixture(scope="module")
def task(scene: Scene, grid: PreviewGrid, reference: TransportTable) -> FitTask:
    config = FitConfig(members=2, network=SHORT, penalties=(1e-4, 1e-2), designs=20)
    return FitTask(
        scene=scene,
        grid=grid,
        cells=training_cells(scene, [reference]),
        exposure=reference.exposure,
        lam=reference.lam,
        bends=np.arange(len(reference.bends)),
        seed=3,
        config=config,
    )


def test_networks_that_were_ended_at_any_step_end_bit_equal(
    rows: RegressionData, reference: TransportTable, scene: Scene, tmp_path: Path
) -> None:
    fold = folds(training_cells(scene, [reference]).group, 3, 0)
    wanted = fit_networks(rows, fold, 3, SHORT, seed=0).state_dict()
    parts = FinishedParts(tmp_path, "key")
    for _ in range(2):
        with pytest.raises(Ended):
            fit_networks(rows, fold, 3, SHORT, 0, EndsAfter(1), parts)
    kept = parts.load("networks")
    assert kept is not None
    assert 0 < int(kept["step"]) < SHORT.steps
    found = fit_networks(rows, fold, 3, SHORT, 0, None, parts).state_dict()
    for name, weight in wanted.items():
        assert torch.equal(found[name], weight)
    # Finished networks take no further step.
    again = fit_networks(rows, fold, 3, SHORT, 0, EndsAfter(1), parts).state_dict()
    assert all(torch.equal(again[name], weight) for name, weight in wanted.items())


def assert_equal(found: Fit, wanted: Fit) -> None:
    state = wanted.residual.state_dict()
    for name, weight in found.residual.state_dict().items():
        assert torch.equal(weight, state[name])
    assert replace(found, residual=wanted.residual) == wanted


def test_a_fit_that_is_ended_after_every_part_ends_bit_equal(
    task: FitTask, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("surrogate.training.mlp.SAVE_SECONDS", 1e9)
    wanted = fit_residual(task, None)
    save, saved = FinishedParts.save, []

    def save_and_end(parts: FinishedParts, name: str, arrays: dict[str, np.ndarray]) -> None:
        save(parts, name, arrays)
        saved.append(name)
        raise Ended

    with monkeypatch.context() as patch:
        patch.setattr(FinishedParts, "save", save_and_end)
        while True:
            try:
                # A task of its own every time, as a new process has.
                found = fit_residual(replace(task, folder=tmp_path), None)
                break
            except Ended:
                pass
    assert_equal(found, wanted)
    # Nothing was made twice.
    assert len(saved) == len(set(saved)) > 10
    assert {"networks-300", "ridge-0.01", "held-out-ridge", "held-out-network-300"} <= set(saved)


@pytest.mark.slow
def test_parts_of_another_seed_are_made_anew(task: FitTask, tmp_path: Path) -> None:
    kept = fit_residual(replace(task, folder=tmp_path), None)
    other = fit_residual(replace(task, seed=4, folder=tmp_path), None)
    assert other.quantiles != kept.quantiles
    assert_equal(other, fit_residual(replace(task, seed=4), None))


def test_a_damaged_part_is_made_again(tmp_path: Path) -> None:
    parts = FinishedParts(tmp_path, "key")
    made = parts.arrays("sum", lambda: {"sum": np.arange(1000.0)})
    path = tmp_path / "sum.npz"
    path.write_bytes(path.read_bytes()[:500])
    assert parts.load("sum") is None
    again = parts.arrays("sum", lambda: {"sum": np.arange(1000.0)})
    np.testing.assert_array_equal(again["sum"], made["sum"])
