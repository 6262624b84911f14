"""Halves of the light paths tell what renders bear out, where held-out cells cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from render.scene import Scene
from surrogate.model.preview_grid import PreviewGrid
from surrogate.runtime.metadata import NONE
from surrogate.training.choose_residual import fit_ensembles
from surrogate.training.dataset import TrainingCells, build_rows, training_cells
from surrogate.training.fit import fit_residual
from surrogate.training.fit_task import FitConfig, FitTask
from surrogate.training.halves import borne_out, mean_gains
from surrogate.training.mlp import NetworkConfig
from tests.surrogate.conftest import invent_reference

pytestmark = pytest.mark.slow

RUN = 0.3
"""Of the noise that cells of one half share, relative."""


@pytest.fixture(scope="module")
def exact(scene: Scene) -> TrainingCells:
    """Cells that hold the preview times a smooth residual, without noise."""
    return training_cells(scene, [invent_reference(scene, noise=1e-9)])


def task_of(scene: Scene, grid: PreviewGrid, light: np.ndarray, runs: np.ndarray) -> FitTask:
    """Return the fit to ``light`` rendered in two halves; each run is noise of one half.

    ``runs`` ``(2, direction, fiber, bend, site, normal)``, relative.
    """
    cells = training_cells(scene, [invent_reference(scene)])
    first, second = light * (1.0 + runs)
    cells = replace(
        cells,
        transport=0.5 * (first + second),
        error=RUN * light,
        half_difference=0.5 * (first - second),
    )
    config = FitConfig(
        members=3,
        network=NetworkConfig(width=8, steps=200, batch=256),
        penalties=(1e-3, 1e-1),
        designs=20,
    )
    bends = np.arange(len(cells.bends))
    return FitTask(scene, grid, cells, 1.0, 0.0, bends, seed=1, config=config)


def smooth_runs(cells: TrainingCells, seed: int) -> np.ndarray:
    """Return noise of two halves that neighboring directions, bends and sites share."""
    rng = np.random.default_rng(seed)
    shape = cells.transport.shape
    axes = [np.linspace(-1.0, 1.0, size) for size in shape]
    out = np.zeros((2, *shape))
    for run in out:
        for lamp in range(shape[1]):
            a, b, c = rng.normal(size=3)
            direction, bend, site = np.ix_(axes[0], axes[2], axes[3])
            run[:, lamp] = RUN * (a * direction + b * bend + c * site)[..., None]
    return out


def preview_of(scene: Scene, grid: PreviewGrid, cells: TrainingCells) -> np.ndarray:
    return np.asarray(np.exp(build_rows(scene, grid, cells).log_preview))


def test_noise_that_neighboring_cells_share_is_not_taken_for_light(
    scene: Scene, grid: PreviewGrid, exact: TrainingCells
) -> None:
    light = preview_of(scene, grid, exact)
    task = task_of(scene, grid, light, smooth_runs(exact, 3))
    fit = fit_residual(task, None)
    assert fit.kind == NONE
    assert fit.splits == ()
    assert [row.name for row in fit.levels][-1] == "ridge"
    # Held-out cells of the same render take the noise for light.
    levels = {row.name: row.facet_rms for row in fit.levels}
    assert levels["ridge"] < 0.9 * levels["preview"]
    with torch.no_grad():
        np.testing.assert_array_equal(task.residuals(fit.residual), 0.0)


def test_what_both_halves_show_is_kept(
    scene: Scene, grid: PreviewGrid, exact: TrainingCells
) -> None:
    noise = 0.05 * np.random.default_rng(2).standard_normal((2, *exact.transport.shape))
    task = task_of(scene, grid, exact.transport, noise)
    found = fit_ensembles(task, None)
    assert found.kind in ("ridge", "network")
    model = found.ridge if found.network is None else found.network
    off = np.abs(task.predicted(model) / exact.transport - 1.0)
    before = np.abs(preview_of(scene, grid, exact) / exact.transport - 1.0)
    assert np.median(off) < 0.2 * np.median(before)


def test_what_dim_lamps_lack_bears_out_nothing_that_bright_ones_lose(
    scene: Scene, grid: PreviewGrid, exact: TrainingCells
) -> None:
    # Dim cells have 1.3 times the light of the preview. One factor for all of them, as a stiff
    # ridge has it, helps most cells and harms the bright ones that colors are made of.
    light = preview_of(scene, grid, exact)
    dim = light < 0.9 * light.mean(axis=(0, 1))
    assert 0.5 < dim.mean() < 0.9
    lifted = np.where(dim, 1.3, 1.0) * light
    noise = 0.02 * np.random.default_rng(4).standard_normal((2, *light.shape))
    rows = task_of(scene, grid, lifted, noise).rows
    factor = float(np.log((np.where(dim, 1.3, 1.0)).mean()))
    gains = mean_gains(rows, lambda *_: np.full(light.shape, factor))
    assert gains.mean() < 0.0
    assert not borne_out(gains)
    even = rows.weight.double().numpy().reshape(light.shape)
    ratio, moved = rows.ratio.double().numpy().reshape(light.shape) - 1.0, np.expm1(factor)
    assert (even * moved * (2.0 * ratio - moved)).sum() > 0.0


def test_a_residual_that_makes_held_out_designs_worse_is_not_kept(
    scene: Scene, grid: PreviewGrid, exact: TrainingCells, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A few dim cells have a thousand times the light of the preview: a ridge follows them.
    light, random = preview_of(scene, grid, exact), np.random.default_rng(7)
    light[(light < np.quantile(light, 0.1)) & (random.random(light.shape) < 0.05)] *= 1000.0
    task = task_of(scene, grid, light, 0.01 * random.standard_normal((2, *light.shape)))
    monkeypatch.setattr(
        "surrogate.training.fit.fit_ensembles",
        lambda *given: replace(fit_ensembles(*given), kind="ridge"),
    )
    fit = fit_residual(task, None)
    levels = {row.name: row.facet_rms for row in fit.levels}
    assert levels["ridge"] > levels["preview"]
    assert fit.kind == NONE


def test_the_gain_is_the_squared_error_that_a_residual_takes_away(
    scene: Scene, grid: PreviewGrid, exact: TrainingCells
) -> None:
    runs = smooth_runs(exact, 5)
    rows = task_of(scene, grid, exact.transport, runs).rows
    residual = np.log(exact.transport) - rows.log_preview
    found = mean_gains(rows, lambda _, number: (0.3, 0.7)[number] * residual).mean()
    light = np.exp(rows.log_preview)
    weight = rows.weight.double().numpy().reshape(residual.shape)
    weight = weight * (light / light.mean(axis=(0, 1))) ** 2
    expected = 0.0
    for number, share in enumerate((0.3, 0.7)):
        other = exact.transport * (1.0 + runs[1 - number]) / np.exp(rows.log_preview) - 1.0
        errors = other**2, (other - np.expm1(share * residual)) ** 2
        expected += 0.5 * float((weight * (errors[0] - errors[1])).sum() / weight.sum())
    assert found == pytest.approx(expected, rel=1e-4)


def test_gains_are_borne_out_beyond_their_scatter() -> None:
    scatter = np.random.default_rng(1).standard_normal(40)
    scatter -= scatter.mean()
    assert borne_out(scatter + 0.4)
    assert not borne_out(scatter + 0.1)
    assert not borne_out(np.zeros(40))
    assert borne_out(scatter + 0.4, tried=9)
    assert borne_out(scatter + 0.3)
    assert not borne_out(scatter + 0.3, tried=9)
    assert borne_out(np.array([0.1]))
    assert not borne_out(np.array([-0.1]))
