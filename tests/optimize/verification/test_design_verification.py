"""A conclusion follows from replicates: gain, tie, bias and the error of the surrogate."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.design import Design, RatedDesign, Rating, ScoreSettings, baseline_design
from optimize.verification.design_renders import DesignRenders
from optimize.verification.design_verification import Verification, paired_comparison
from render.metric import choose_exposure, choose_lambda, image_counts
from render.scene import Scene

REPLICATES, SURROGATE = 12, 70.0


def light(scene: Scene) -> np.ndarray:
    """Return an invented transport ``(F, B, S, K)`` whose facets see fibers from one side."""
    shape = (len(scene.bending.angles), scene.sites.count, scene.indenter.faces)
    fiber = 2 * np.pi * np.arange(scene.lamp_count) / scene.lamp_count
    facet = 2 * np.pi * np.arange(scene.indenter.faces) / scene.indenter.faces
    lobes = 1.2 + np.cos(fiber[:, None] - facet)
    fade = 1.0 / (1.0 + 0.1 * np.arange(shape[1]))
    return np.broadcast_to(
        lobes[:, None, None, :] * fade[:, None], (scene.lamp_count, *shape)
    ).copy()


def candidate(scene: Scene, design: Design) -> RatedDesign:
    transport, base = light(scene), baseline_design(scene)
    exposure = choose_exposure(np.einsum("fbsk,fc->bskc", transport, base.power))
    lam = choose_lambda(image_counts(transport, base.power, exposure))
    rating = Rating(
        "surrogate", SURROGATE, (60.0, 80.0), 90.0, 12.0, 8.0, ScoreSettings(exposure, lam)
    )
    return RatedDesign(scene, design, rating)


def noisy(transport: np.ndarray, sigma: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return transport * (1 + sigma * rng.standard_normal((REPLICATES, *transport.shape)))


def compared(
    scene: Scene, design: Design, baseline_light: np.ndarray, design_light: np.ndarray
) -> Verification:
    """Return what pretended replicates ``(R, F, B, S, K)`` say of the design."""
    rated, replicates = candidate(scene, design), np.stack([baseline_light, design_light], axis=1)
    error = replicates.std(axis=0, ddof=1) / np.sqrt(REPLICATES)
    pair = DesignRenders((rated.baseline, design), replicates, replicates[..., 0], error, 1.0)
    return paired_comparison(rated, pair, None, surrogate_score=SURROGATE, seeds=(1, 2), samples=8)


def with_noise(scene: Scene, design: Design, sigma: float, brighter: float = 1.0) -> Verification:
    first, second = noisy(light(scene), sigma, 1), noisy(brighter * light(scene), sigma, 2)
    return compared(scene, design, first, second)


@pytest.fixture(scope="module")
def other(finger20: Scene) -> Design:
    """Return a design that points elsewhere, so that it is rendered on its own."""
    base = baseline_design(finger20)
    return Design(base.phi - 0.1, base.power)


def test_a_clear_loss_is_called_worse(finger20: Scene, other: Design) -> None:
    found = with_noise(finger20, other, sigma=0.02, brighter=0.5)
    assert found.difference.interval()[1] < 0
    assert "worse" in found.conclusion
    assert found.difference.value == pytest.approx(
        found.design.score.value - found.baseline.score.value, rel=1e-9
    )


def test_noise_alone_is_called_a_tie(finger20: Scene, other: Design) -> None:
    found = with_noise(finger20, other, sigma=0.3)
    low, high = found.difference.interval()
    assert low < 0 < high
    assert "tie" in found.conclusion


def test_a_clear_gain_decides_nothing_where_few_light_paths_carry_the_light(
    finger20: Scene, other: Design
) -> None:
    replicates = np.stack([noisy(f * light(finger20), 0.02, 1) for f in (0.5, 1.0)], axis=1)
    rated, mean = candidate(finger20, other), replicates.mean(axis=0)

    def found(error: np.ndarray) -> Verification:
        pair = DesignRenders((rated.baseline, other), replicates, replicates[..., 0], error, 1.0)
        return paired_comparison(
            rated, pair, None, surrogate_score=SURROGATE, seeds=(1, 2), samples=600
        )

    assert "is better in S" in found(0.1 * mean).conclusion
    assert found(0.1 * mean).to_json()["converged"] is True
    # Half of the cells is known to its own size: four times the samples halve that.
    error = 0.1 * mean
    error[:, ::2] = mean[:, ::2]
    unsure = found(error)
    assert unsure.conclusion.startswith("The renders have not converged and decide nothing")
    assert "about 1,800 samples more per cell are needed" in unsure.conclusion
    assert unsure.to_json()["converged"] is False


def test_cells_that_carry_little_of_the_light_may_be_uncertain(
    finger20: Scene, other: Design
) -> None:
    replicates = noisy(light(finger20), 0.02, 1)
    mean = replicates.mean(axis=0)
    error = np.where(mean < np.quantile(mean, 0.1), mean, 0.1 * mean)
    renders = DesignRenders(
        (other,), replicates[:, None], replicates[:, None, ..., 0], error[None], 1.0
    )
    assert renders.doubt(candidate(finger20, other).settings, 0) == ""


def test_a_design_that_lights_nothing_has_no_doubt_and_is_worse(finger20: Scene) -> None:
    dark = Design.of_colors(baseline_design(finger20).phi, [-1] * finger20.lamp_count)
    found = with_noise(finger20, dark, sigma=0.02)
    assert found.doubt == ""
    assert found.design.score.interval() == (0.0, 0.0)
    assert found.difference.value == pytest.approx(-found.baseline.score.value)
    assert "is worse" in found.conclusion


def test_equal_noise_of_a_recolored_design_cancels_in_the_difference(finger20: Scene) -> None:
    base = baseline_design(finger20)
    swapped = Design.of_colors(base.phi, (base.colors + 1) % 3)
    replicates = noisy(light(finger20), 0.3, 1)
    found = compared(finger20, swapped, replicates, replicates)
    assert found.baseline.score.se > 0.1
    assert found.difference.value == pytest.approx(0.0, abs=1e-6)
    assert found.difference.se < 1e-6


def test_the_bias_of_noisy_renders_is_taken_out(finger20: Scene, other: Design) -> None:
    exact = with_noise(finger20, other, sigma=0.0).baseline.score.value
    found = with_noise(finger20, other, sigma=0.5).baseline.score
    assert found.plain < exact
    assert abs(found.value - exact) < abs(found.plain - exact)
    assert abs(found.value - exact) < 3 * found.se


def test_parts_add_up_and_the_surrogate_error_is_reported(finger20: Scene, other: Design) -> None:
    found = with_noise(finger20, other, sigma=0.1)
    parts = {name: estimate.value for name, estimate in found.design.parts.items()}
    assert parts["score"] == pytest.approx(
        parts["mean"] - parts["spread_sites"] - parts["spread_bends"]
    )
    result = found.to_json()
    assert list(result) == [
        "baseline",
        "design",
        "difference",
        "surrogate",
        "converged",
        "render_seconds",
        "seeds",
    ]
    assert result["surrogate"] == {"score": SURROGATE, "error": SURROGATE - parts["score"]}
