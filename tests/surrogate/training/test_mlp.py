"""Fitting ridge and networks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from render.scene import Scene
from render.transport import TransportTable
from surrogate.model.networks import RidgeEnsemble, quadratic
from surrogate.model.preview_grid import PreviewGrid
from surrogate.training.dataset import (
    RegressionData,
    TrainingCells,
    build_rows,
    folds,
    training_cells,
)
from surrogate.training.fit_task import out_of_fold
from surrogate.training.mlp import NetworkConfig, deviance, fit_networks
from surrogate.training.ridge import fit_ridge

SHORT = NetworkConfig(width=8, steps=300, batch=256)


@pytest.fixture(scope="module")
def cells(scene: Scene, reference: TransportTable) -> TrainingCells:
    return training_cells(scene, [reference])


@pytest.fixture(scope="module")
def rows(scene: Scene, grid: PreviewGrid, cells: TrainingCells) -> RegressionData:
    return build_rows(scene, grid, cells)


def _error(rows: RegressionData, residuals: np.ndarray, fold: np.ndarray) -> float:
    """Return the median error of held-out cells."""
    out = out_of_fold(residuals, fold).reshape(rows.ratio.shape)
    return float(np.median(np.abs(np.exp(out) / rows.ratio.numpy() - 1)))


@torch.no_grad()
def test_ridge_predicts_held_out_cells_to_their_noise(
    rows: RegressionData, cells: TrainingCells
) -> None:
    fold = folds(cells.group, 3, 0)
    model = fit_ridge(rows, fold, 3, 1e-5)
    assert _error(rows, rows.residuals(model(rows.x)), fold) < 0.025  # noise alone: 0.0135


def test_networks_predict_held_out_cells_to_their_noise(
    rows: RegressionData, cells: TrainingCells
) -> None:
    fold = folds(cells.group, 3, 0)
    model = fit_networks(rows, fold, 3, replace(SHORT, steps=600), seed=0)
    with torch.no_grad():
        found = _error(rows, rows.residuals(model(rows.x)), fold)
    assert found < 0.025


def test_the_same_seed_gives_the_same_networks(rows: RegressionData, cells: TrainingCells) -> None:
    fold = folds(cells.group, 2, 0)
    first, again, other = (
        fit_networks(rows, fold, 2, replace(SHORT, steps=40), seed=s) for s in (1, 1, 2)
    )
    pairs = zip(first.parameters(), again.parameters(), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    assert not torch.equal(first.weight1, other.weight1)


@torch.no_grad()
def test_a_member_never_sees_its_own_fold(rows: RegressionData, cells: TrainingCells) -> None:
    fold = folds(cells.group, 2, 0)
    hidden = rows.fold_rows(fold) == 0
    spoiled = replace(rows, ratio=torch.where(hidden[:, None], 50.0, rows.ratio))
    with torch.enable_grad():
        plain, other = (
            fit_networks(r, fold, 2, replace(SHORT, steps=40), seed=0) for r in (rows, spoiled)
        )
    assert torch.equal(plain.weight1[0], other.weight1[0])
    assert not torch.equal(plain.weight1[1], other.weight1[1])
    ridges = [fit_ridge(r, fold, 2, 1e-4).weight for r in (rows, spoiled)]
    torch.testing.assert_close(ridges[0][0], ridges[1][0])


@torch.no_grad()
def test_ridge_has_all_products_of_the_inputs() -> None:
    model = RidgeEnsemble(torch.ones(1, 6, 1), 2)
    x = torch.tensor([[2.0, 3.0]])
    assert quadratic(x, model.first, model.second).tolist() == [[1, 2, 3, 4, 6, 9]]
    assert model(x).item() == 25.0


def test_cells_with_little_noise_weigh_more(rows: RegressionData) -> None:
    quiet, loud = (replace(rows, noise=torch.full_like(rows.noise, n)) for n in (0.001, 0.5))
    assert quiet.weight.mean() > 100 * loud.weight.mean()


def test_held_out_takes_each_cell_from_the_member_that_did_not_see_it() -> None:
    residuals = np.arange(2.0)[:, None, None, None, None, None] * np.ones((1, 3, 1, 1, 1, 1))
    fold = np.array([0, 1, -1]).reshape(3, 1, 1)
    assert out_of_fold(residuals, fold).ravel().tolist() == [0.0, 1.0, 0.5]


def test_the_deviance_of_noisy_cells_is_smallest_at_the_logarithm_of_their_mean() -> None:
    rng = np.random.default_rng(0)
    # Half of the cells came out black: least squares in the logarithm could not use them.
    noisy = torch.as_tensor(rng.choice([0.0, 2.0], 5000), dtype=torch.float32)
    residuals = torch.linspace(-0.5, 0.5, 101)
    loss = [float(deviance(noisy, r).mean()) for r in residuals]
    assert abs(float(residuals[int(np.argmin(loss))]) - float(torch.log(noisy.mean()))) < 0.011


@torch.no_grad()
def test_wild_predictions_stay_numbers_with_exponentials(
    rows: RegressionData, cells: TrainingCells
) -> None:
    fold = folds(cells.group, 3, 0)
    # Inputs far beyond the others: what their products predict is no logarithm of anything.
    far = replace(rows, x=rows.x * torch.where(rows.fold_rows(fold) == 0, 1e3, 1.0)[:, None])
    model = fit_ridge(far, fold, 3, 1e-5)
    wild = 1e6 * model(far.x)
    assert np.isfinite(np.exp(far.residuals(wild))).all()
    assert torch.isfinite(model(far.x)).all()


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_dark_rows_that_say_little_far_from_the_others_leave_a_ridge(
    rows: RegressionData, cells: TrainingCells, way: float
) -> None:
    fold = np.full(cells.group.shape, -1)
    dark = (torch.arange(len(rows.x)) % 97 == 0)[:, None]
    few = replace(
        rows,
        x=torch.where(dark, 1e4 * way * rows.x, rows.x),
        ratio=torch.where(dark, 0.0, rows.ratio),
        noise=torch.where(dark, 1e3, rows.noise),
    )
    model = fit_ridge(few, fold, 1, 1e-5)
    with torch.no_grad():
        assert np.isfinite(few.residuals(model(few.x))).all()
