"""The model of a sensor whose lamps cannot turn: its table, weighed against its preview."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from render.levels import TABLE
from render.scene import load_scene, unchecked
from render.transport import TransportTable
from surrogate.model.preview_grid import PreviewGrid, draw_grid, is_one_node
from surrogate.runtime.metadata import NONE
from surrogate.training.dataset import training_cells
from surrogate.training.fit import Fit
from surrogate.training.fit_table import fit_table
from surrogate.training.fit_task import FitConfig, FitTask

SCENE = load_scene("gelsight-mini")


@pytest.fixture(scope="module")
def drawn() -> PreviewGrid:
    return draw_grid(SCENE, 1, 1)


def fitted(
    drawn: PreviewGrid,
    *,
    off: float,
    noise: float,
    seed: int = 0,
    grid: PreviewGrid | None = None,
    known: float | None = None,
) -> tuple[Fit, np.ndarray, np.ndarray]:
    """Return the fit, the light of its model and the true one.

    The preview is off by ``off`` and renders by ``noise``, both relative; ``grid`` is another
    preview that the model is given instead, ``known`` the half-width of its scores' interval.
    """
    rng = np.random.default_rng(seed)
    preview = np.exp(drawn.log_transport)
    true = preview * np.exp(off * rng.standard_normal(preview.shape))
    # Both halves are noisier than the whole by the root of two; no render is below 0.
    shape = 0.5 / noise**2
    halves = [true * rng.gamma(shape, 1.0 / shape, true.shape) for _ in range(2)]
    mean, error = 0.5 * (halves[0] + halves[1]), noise * true
    table = TransportTable(
        T=mean[..., :-1],
        se=error[..., :-1],
        phi=drawn.phi,
        bends=drawn.bends,
        background=mean[..., -1],
        background_se=error[..., -1],
        half_difference=0.5 * (halves[0] - halves[1]),
        exposure=2e5,
        lam=800.0,
    )
    task = FitTask(
        scene=SCENE,
        grid=grid or drawn,
        cells=training_cells(SCENE, [table]),
        exposure=table.exposure,
        lam=table.lam,
        bends=np.array([0]),
        seed=0,
        config=FitConfig(),
        preview_half_width=known,
    )
    fit, made = fit_table(task)
    return fit, np.exp(made.log_transport), true


def rms(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.sqrt(np.mean((found / true - 1.0) ** 2)))


def test_lamps_that_cannot_turn_on_a_flat_pad_leave_nothing_between_nodes() -> None:
    assert is_one_node(SCENE)
    assert not is_one_node(load_scene("finger20"))
    bends = unchecked(SCENE.bending, {"angles": (0.0, 0.5)})
    assert not is_one_node(unchecked(SCENE, {"bending": bends}))


@pytest.mark.parametrize(("off", "noise"), [(0.03, 0.03), (0.1, 0.03), (0.03, 0.1)])
def test_preview_and_renders_together_are_as_good_as_their_variances_allow(
    drawn: PreviewGrid, off: float, noise: float
) -> None:
    fit, found, true = fitted(drawn, off=off, noise=noise)
    # The variance of the best mean of two: 1 / (1 / a^2 + 1 / b^2).
    assert rms(found, true) == pytest.approx(off * noise / np.hypot(off, noise), rel=0.1)
    # Where the best mean gains less than a twentieth, renders may well bear nothing out.
    assert fit.kind == TABLE or noise > 3.0 * off


def test_renders_that_find_nothing_leave_the_preview_as_it_is(drawn: PreviewGrid) -> None:
    kinds = []
    for seed in range(4):
        fit, found, _ = fitted(drawn, off=0.0, noise=0.05, seed=seed)
        kinds.append(fit.kind)
        if fit.kind == NONE:
            np.testing.assert_allclose(found, np.exp(drawn.log_transport), rtol=1e-6)
    assert kinds.count(NONE) >= 3


def test_half_the_renders_cannot_tell_the_preview_s_rank_from_the_whole_s(
    drawn: PreviewGrid,
) -> None:
    tau = {}
    for noise in (0.002, 0.3):
        fit, *_ = fitted(drawn, off=0.3, noise=noise)
        tau[noise] = {row.name: row.kendall_tau for row in fit.levels}
    assert tau[0.002][TABLE] > 0.97
    assert tau[0.3].get(TABLE, 0.0) < tau[0.002][TABLE]


@pytest.mark.parametrize("off", [0.0, 0.03])
def test_intervals_hold_the_light_without_noise(drawn: PreviewGrid, off: float) -> None:
    fit, found, true = fitted(drawn, off=off, noise=0.03)
    assert fit.coverage is not None
    assert fit.coverage.counts == pytest.approx(0.9, abs=0.02)
    # One lamp alone: its cells, against the truth that the renders never showed.
    spread = np.exp(fit.spread[0])
    held = np.abs(found / true - 1.0) <= fit.quantiles.counts * spread
    assert held.mean() >= 0.87


def test_cells_that_the_preview_has_black_are_taken_from_the_renders(drawn: PreviewGrid) -> None:
    dark = drawn.log_transport.copy()
    dark[0] = dark.max() - 20.0
    fit, found, true = fitted(drawn, off=0.05, noise=0.02, grid=replace(drawn, log_transport=dark))
    assert fit.kind == TABLE
    assert rms(found[0], true[0]) < 0.05


def test_noise_that_hides_the_scores_leaves_the_interval_of_the_preview(
    drawn: PreviewGrid,
) -> None:
    # Of the last, no cell has converged.
    for noise in (0.4, 0.9):
        for seed in range(3):
            fit, *_ = fitted(drawn, off=0.01, noise=noise, seed=seed, known=3.0)
            assert fit.quantiles.score == pytest.approx(3.0)
            assert fit.quantiles.effort > 2.0
    fit, *_ = fitted(drawn, off=0.3, noise=0.003, known=0.5)
    assert fit.quantiles.effort == 1.0
    assert fit.quantiles.score != pytest.approx(0.5)
