"""What holds for every design, whatever the residual is."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from render.geometry import fiber_edges, mirror_twins
from render.metric import image_counts
from render.scene import Scene
from surrogate.model.checker_module import CheckerModule
from surrogate.model.facet_basis import SIZE
from surrogate.model.features import FEATURE_NAMES
from surrogate.model.networks import NetworkEnsemble, NoResidual
from surrogate.model.preview_grid import PreviewGrid

# Low enough that nothing clips: light adds up only below the camera's limit.
EXPOSURE, LAM = 2e5, 40.0
Design = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=8)
fewer = settings(max_examples=3)


def network(scale: float = 0.1) -> NetworkEnsemble:
    generator = torch.Generator().manual_seed(0)
    net = NetworkEnsemble(3, len(FEATURE_NAMES), 8, SIZE, generator)
    with torch.no_grad():
        net.weight3.copy_(scale * torch.randn(net.weight3.shape, generator=generator))
    return net


@pytest.fixture(scope="module")
def checker(scene: Scene, grid: PreviewGrid) -> CheckerModule:
    return CheckerModule(scene, grid, network(), exposure=EXPOSURE, lam=LAM, spread=(-3.0, 0.1))


@pytest.fixture(scope="module")
def sharp(scene: Scene, grid: PreviewGrid) -> CheckerModule:
    """A checker whose brightest facets saturate."""
    return CheckerModule(scene, grid, network(), exposure=1e9, lam=LAM, spread=(-3.0, 0.1))


def design(scene: Scene, seed: int) -> Design:
    rng = np.random.default_rng(seed)
    fibers = scene.lamp_count
    phi = rng.choice([0.0, math.pi, *rng.uniform(0, math.pi, 6)], (1, fibers))
    power = rng.uniform(0, 1, (1, fibers, 3)) * rng.choice([0.0, 1.0], (1, fibers, 3))
    bend = rng.choice([0.0, 1e-6, *scene.bending.angles], (1, 3))
    return tuple(torch.as_tensor(x, dtype=torch.float32) for x in (phi, power, bend))  # type: ignore[return-value]


@few
@given(seed=seeds)
@torch.no_grad()
def test_light_adds_up(checker: CheckerModule, scene: Scene, seed: int) -> None:
    phi, power, bend = design(scene, seed)
    share = torch.rand(power.shape, generator=torch.Generator().manual_seed(seed))
    both, first, second = (
        checker(phi, p, bend) for p in (power, share * power, (1 - share) * power)
    )
    torch.testing.assert_close(both.counts, first.counts + second.counts, rtol=1e-5, atol=1e-4)
    sums = first.background + second.background
    torch.testing.assert_close(both.background, sums, rtol=1e-5, atol=1e-4)


@few
@given(seed=seeds, factor=st.floats(1e-3, 1.0))
@torch.no_grad()
def test_dimming_all_light_dims_counts_and_spread_and_keeps_the_hue(
    checker: CheckerModule, scene: Scene, seed: int, factor: float
) -> None:
    phi, power, bend = design(scene, seed)
    full, dim = checker(phi, power, bend), checker(phi, factor * power, bend)
    for name in ("counts", "counts_spread", "background"):
        bright, dark = getattr(full, name), getattr(dim, name)
        torch.testing.assert_close(factor * bright, dark, rtol=1e-4, atol=1e-5)


@few
@given(seed=seeds, order=st.permutations([0, 1, 2]))
@torch.no_grad()
def test_colors_have_no_names(
    checker: CheckerModule, scene: Scene, seed: int, order: list[int]
) -> None:
    phi, power, bend = design(scene, seed)
    plain, permuted = checker(phi, power, bend), checker(phi, power[..., order], bend)
    torch.testing.assert_close(permuted.counts, plain.counts[..., order])
    torch.testing.assert_close(permuted.score, plain.score, rtol=1e-5, atol=1e-4)


@few
@given(seed=seeds)
@torch.no_grad()
def test_the_mirrored_design_scores_the_same(
    checker: CheckerModule, scene: Scene, seed: int
) -> None:
    phi, power, bend = design(scene, seed)
    twin = mirror_twins(scene).twin.copy()
    tip = torch.tensor([edge == "tip" for edge in fiber_edges(scene)])
    turned = torch.where(tip, math.pi - phi[:, twin], phi[:, twin])
    here, there = checker(phi, power, bend), checker(turned, power[:, twin], bend)
    # As symmetric as the drawn preview.
    torch.testing.assert_close(here.score, there.score, rtol=5e-3, atol=0.05)


@few
@given(seed=seeds)
@torch.no_grad()
def test_zero_residual_is_the_preview(scene: Scene, grid: PreviewGrid, seed: int) -> None:
    bare = CheckerModule(
        scene, grid, NoResidual(SIZE), exposure=EXPOSURE, lam=LAM, spread=(-3.0, 0.0)
    )
    phi, power, bend = design(scene, seed)
    light = np.exp(grid.evaluate(phi[0].double().numpy(), bend[0].double().numpy()))
    own = light[np.arange(scene.lamp_count), np.arange(scene.lamp_count)]
    expected = image_counts(own[..., :-1], power[0].double().numpy(), EXPOSURE)
    np.testing.assert_allclose(bare(phi, power, bend).counts[0], expected, rtol=2e-4, atol=1e-4)


@fewer
@given(seed=seeds)
@torch.no_grad()
@pytest.mark.parametrize("which", ["checker", "sharp"])
def test_float32_is_float64_to_a_hundredth_of_a_count(
    request: pytest.FixtureRequest, scene: Scene, which: str, seed: int
) -> None:
    model: CheckerModule = request.getfixturevalue(which)
    inputs = design(scene, seed)
    single = model(*inputs)
    exact = model.double()(*(x.double() for x in inputs))
    model.float()
    for name, value in single._asdict().items():
        other = getattr(exact, name)
        torch.testing.assert_close(
            value.double(), other, rtol=2e-4, atol=0.01, msg=lambda m, n=name: f"{n}: {m}"
        )


@torch.no_grad()
@pytest.mark.parametrize("power", [0.0, 1.0])
def test_no_light_and_too_much_light_are_finite(
    checker: CheckerModule, sharp: CheckerModule, scene: Scene, power: float
) -> None:
    phi, _, bend = design(scene, 1)
    light = torch.full((1, scene.lamp_count, 3), power)
    for model in (checker, sharp):
        found = model(phi, light, bend)
        assert all(value.isfinite().all() for value in found)
        assert ((found.counts >= 0) & (found.counts <= 255)).all()
        if power == 0.0:
            assert found.score.item() == 0.0
            assert (found.counts == 0).all()
    if power == 1.0:
        assert (sharp(phi, light, bend).counts == 255.0).all()


@torch.no_grad()
@pytest.mark.parametrize("color", [0, 1, 2])
def test_all_fibers_one_color_and_a_single_fiber_are_finite(
    checker: CheckerModule, scene: Scene, color: int
) -> None:
    phi, _, bend = design(scene, 2)
    power = torch.zeros(2, scene.lamp_count, 3)
    power[0, :, color] = 1.0
    power[1, 3, color] = 1.0
    found = checker(phi.expand(2, -1), power, bend.expand(2, -1))
    assert all(value.isfinite().all() for value in found)
    others = [c for c in range(3) if c != color]
    assert (found.counts[..., others] == 0).all()
    assert (found.counts[..., color] > 0).all()
