"""The regression problem of the residual."""

from __future__ import annotations

import numpy as np
import torch

from render.scene.schema import Scene
from render.transport import TransportTable
from surrogate.model.preview_grid import PreviewGrid
from surrogate.training.dataset import cells_from_table
from surrogate.training.regression import build_rows, deviance, held_out, smooth_noise


def test_the_ratio_is_reference_over_preview(
    scene: Scene, grid: PreviewGrid, reference: TransportTable
) -> None:
    cells = cells_from_table(scene, reference)
    rows = build_rows(scene, grid, cells)
    ratio = rows.ratio.numpy().reshape(cells.transport.shape)
    preview = np.exp(grid.log_transport).swapaxes(0, 1)
    np.testing.assert_allclose(ratio, cells.transport / preview, rtol=1e-4)


def test_the_smoothed_noise_is_the_true_one_though_error_bars_scatter() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(4000, 2))
    truth = 0.1 * np.exp(0.5 * x[:, :1]) * np.ones((1, 3))
    value = np.exp(rng.normal(size=truth.shape))
    bars = value * truth * np.sqrt(rng.chisquare(7, truth.shape) / 7)
    smooth = smooth_noise(value, bars, x)
    np.testing.assert_allclose(smooth, truth, rtol=0.12)


def test_an_exact_reference_has_no_noise() -> None:
    assert (smooth_noise(np.ones((5, 2)), np.zeros((5, 2)), np.ones((5, 1))) == 0).all()


def test_the_deviance_of_noisy_cells_is_smallest_at_the_logarithm_of_their_mean() -> None:
    rng = np.random.default_rng(0)
    # Half of the cells came out black: least squares in the logarithm could not use them.
    noisy = torch.as_tensor(rng.choice([0.0, 2.0], 5000), dtype=torch.float32)
    grades = torch.linspace(-0.5, 0.5, 101)
    loss = [float(deviance(noisy, r).mean()) for r in grades]
    assert abs(float(grades[int(np.argmin(loss))]) - float(torch.log(noisy.mean()))) < 0.011


def test_held_out_takes_each_cell_from_the_member_that_did_not_see_it() -> None:
    residuals = np.arange(2.0)[:, None, None, None, None, None] * np.ones((1, 3, 1, 1, 1, 1))
    fold = np.array([0, 1, -1]).reshape(3, 1, 1)
    assert held_out(residuals, fold).ravel().tolist() == [0.0, 1.0, 0.5]
