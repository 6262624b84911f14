"""The checker as a torch module: physics that holds whatever the residual is."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from render.geometry import fiber_edges, mirror_twins
from render.metric import image_counts
from render.preview import Preview
from render.scene import Scene
from surrogate.model.checker_module import CheckerModule, Lagrange
from surrogate.model.facet_basis import SIZE
from surrogate.model.features import FEATURE_NAMES
from surrogate.model.networks import NetworkEnsemble, NoResidual
from surrogate.model.preview_grid import PreviewGrid

# Low enough that nothing clips: light adds up only below the camera's limit.
EXPOSURE, LAM = 2e5, 40.0


def _network(seed: int = 0) -> NetworkEnsemble:
    generator = torch.Generator().manual_seed(seed)
    net = NetworkEnsemble(3, len(FEATURE_NAMES), 8, SIZE, generator)
    with torch.no_grad():
        net.weight3.copy_(0.1 * torch.randn(net.weight3.shape, generator=generator))
    return net


@pytest.fixture(scope="module")
def checker(scene: Scene, grid: PreviewGrid) -> CheckerModule:
    return CheckerModule(scene, grid, _network(), exposure=EXPOSURE, lam=LAM, spread=(-3.0, 0.1))


def _design(scene: Scene, count: int = 2) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(5)
    fibers = scene.lamp_count
    return (
        torch.as_tensor(rng.uniform(0, np.pi, (count, fibers)), dtype=torch.float32),
        torch.as_tensor(rng.uniform(0, 1, (count, fibers, 3)), dtype=torch.float32),
        torch.as_tensor(np.tile(scene.bending.angles, (count, 1)), dtype=torch.float32),
    )


def test_without_residual_the_counts_are_those_of_the_preview(
    scene: Scene, grid: PreviewGrid
) -> None:
    bare = CheckerModule(
        scene, grid, NoResidual(SIZE), exposure=EXPOSURE, lam=LAM, spread=(-3.0, 0.0)
    )
    phi = torch.full((1, scene.lamp_count), float(grid.phi[3]))
    _, power, _ = _design(scene, 1)
    bends = grid.bends[[0, 2]]
    with Preview(scene) as preview:
        transport, background = preview.transport(grid.phi[3:4], bends)
    found = bare(phi, power, torch.as_tensor(bends, dtype=torch.float32)[None])
    expected = image_counts(transport[:, 0], power[0].double().numpy(), EXPOSURE)
    np.testing.assert_allclose(found.counts[0].numpy(), expected, rtol=1e-4)
    untouched = image_counts(background[:, 0, ..., None], power[0].double().numpy(), EXPOSURE)
    np.testing.assert_allclose(found.background[0].numpy(), untouched[..., 0, :], rtol=1e-4)


def test_an_untrained_network_is_the_preview(scene: Scene, grid: PreviewGrid) -> None:
    fresh = NetworkEnsemble(2, len(FEATURE_NAMES), 8, SIZE, torch.Generator().manual_seed(0))
    models = [
        CheckerModule(scene, grid, net, exposure=EXPOSURE, lam=LAM, spread=(-3.0, 0.0))
        for net in (fresh, NoResidual(SIZE))
    ]
    with torch.no_grad():
        first, second = (model(*_design(scene)) for model in models)
    torch.testing.assert_close(first.counts, second.counts, rtol=1e-6, atol=1e-6)


@torch.no_grad()
def test_light_of_two_designs_adds_up(checker: CheckerModule, scene: Scene) -> None:
    phi, power, bend = _design(scene, 1)
    parts = [
        power * mask for mask in (torch.arange(scene.lamp_count)[:, None] % 2 == k for k in (0, 1))
    ]
    both, first, second = (checker(phi, p, bend) for p in (power, *parts))
    torch.testing.assert_close(both.counts, first.counts + second.counts, rtol=1e-5, atol=1e-4)
    torch.testing.assert_close(
        both.background, first.background + second.background, rtol=1e-5, atol=1e-4
    )


@torch.no_grad()
def test_half_the_exposure_halves_counts_and_spread(scene: Scene, grid: PreviewGrid) -> None:
    full, half = (
        CheckerModule(scene, grid, _network(), exposure=e, lam=LAM, spread=(-3.0, 0.1))(
            *_design(scene)
        )
        for e in (EXPOSURE, EXPOSURE / 2)
    )
    torch.testing.assert_close(full.counts, 2 * half.counts)
    torch.testing.assert_close(full.counts_spread, 2 * half.counts_spread)


@torch.no_grad()
def test_permuted_colors_permute_the_counts_and_leave_the_score(
    checker: CheckerModule, scene: Scene
) -> None:
    phi, power, bend = _design(scene)
    order = [2, 0, 1]
    plain, permuted = checker(phi, power, bend), checker(phi, power[..., order], bend)
    torch.testing.assert_close(permuted.counts, plain.counts[..., order])
    torch.testing.assert_close(permuted.counts_spread, plain.counts_spread[..., order])
    torch.testing.assert_close(permuted.score, plain.score)


@torch.no_grad()
def test_the_mirrored_design_has_the_mirrored_picture(checker: CheckerModule, scene: Scene) -> None:
    phi, power, bend = _design(scene, 1)
    twin = mirror_twins(scene).twin.copy()
    tip = torch.tensor([edge == "tip" for edge in fiber_edges(scene)])
    turned = torch.where(tip, math.pi - phi[:, twin], phi[:, twin])
    here, there = checker(phi, power, bend), checker(turned, power[:, twin], bend)
    sites = np.arange(scene.sites.count).reshape(scene.sites.rows, scene.sites.columns)
    faces = -np.arange(scene.indenter.faces) % scene.indenter.faces
    mirrored = there.counts[:, :, sites[:, ::-1].ravel().copy()][..., faces, :]
    # As symmetric as the drawn preview.
    torch.testing.assert_close(here.counts, mirrored, rtol=0.01, atol=0.05)


@torch.no_grad()
def test_inside_the_trained_range_there_is_no_excess(checker: CheckerModule, scene: Scene) -> None:
    phi, power, bend = _design(scene, 1)
    phi[0, :2] = torch.tensor([0.0, math.pi])
    power[0, 0] = torch.tensor([0.0, 1.0, 1.0])
    assert checker(phi, power, bend).domain_excess.item() == 0.0


@torch.no_grad()
@pytest.mark.parametrize("which", [0, 1, 2])
def test_excess_grows_with_the_distance_from_the_trained_range(
    checker: CheckerModule, scene: Scene, which: int
) -> None:
    excess = []
    for beyond in (0.0, 0.1, 1.0, 100.0, math.inf):
        inputs = _design(scene, 1)
        inputs[which].view(-1)[1] = (math.pi, 1.0, checker.bends[1])[which] + beyond
        excess.append(checker(*inputs).domain_excess.item())
    assert excess[0] == 0.0
    assert all(a < b for a, b in pairwise(excess))
    assert excess[-1] == math.inf


@torch.no_grad()
@pytest.mark.parametrize("which", [0, 1, 2])
def test_nan_in_gives_nan_out_for_that_design_alone(
    checker: CheckerModule, scene: Scene, which: int
) -> None:
    inputs = _design(scene, 2)
    clean = checker(*inputs)
    inputs[which][1].view(-1)[0] = math.nan
    found = checker(*inputs)
    assert found.score[1].isnan()
    assert found.counts[1].isnan().any()
    assert found.domain_excess[1].item() == math.inf
    torch.testing.assert_close(found.counts[0], clean.counts[0])
    assert found.domain_excess[0].item() == 0.0


def test_the_score_can_be_differentiated_at_the_ends_and_the_nodes(
    checker: CheckerModule, scene: Scene
) -> None:
    phi, power, bend = _design(scene, 1)
    phi[0, :3] = torch.tensor([0.0, math.pi, math.pi / 2])
    phi.requires_grad_(True)
    checker(phi, power, bend).score.sum().backward()  # type: ignore[no-untyped-call]
    assert phi.grad is not None
    assert phi.grad.isfinite().all()


def test_the_derivative_is_the_slope_of_the_score(checker: CheckerModule, scene: Scene) -> None:
    phi, power, bend = _design(scene, 1)
    phi.requires_grad_(True)
    checker(phi, power, bend).counts.mean().backward()  # type: ignore[no-untyped-call]
    assert phi.grad is not None
    step = 0.02
    moved = [phi.detach().clone() for _ in range(2)]
    moved[0][0, 0] -= step
    moved[1][0, 0] += step
    with torch.no_grad():
        low, high = (checker(p, power, bend).counts.mean() for p in moved)
    slope = float(high - low) / (2 * step)
    assert float(phi.grad[0, 0]) == pytest.approx(slope, rel=0.05, abs=1e-3)


def test_lagrange_weights_are_those_of_the_barycentric_formula(grid: PreviewGrid) -> None:
    from render.chebyshev import interpolation_weights

    x = np.concatenate([grid.phi, np.linspace(0, np.pi, 23)])
    found = Lagrange(grid.phi)(torch.as_tensor(x, dtype=torch.float32)).numpy()
    np.testing.assert_allclose(found, interpolation_weights(grid.phi, x), atol=2e-6)
