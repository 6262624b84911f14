"""Intervals of scores that a scene's two previews calibrate."""

from __future__ import annotations

import numpy as np
import pytest

from render.scene import Scene, load_scene, unchecked
from surrogate.preview_interval import (
    BENT_FLOOR,
    BRIGHTNESS_SHARE,
    COVERAGE,
    DESIGNS,
    DIFFERENCE_SHARE,
    DIFFUSER_FLOOR,
    FLAT_FLOOR,
    HUE_SHARE,
    followed_half_width,
    preview_difference,
)


@pytest.fixture(scope="module", params=["finger20", "digit"])
def scene(request: pytest.FixtureRequest) -> Scene:
    return load_scene(request.param)


def brightness(phi: np.ndarray, power: np.ndarray) -> np.ndarray:
    return power.sum(axis=(1, 2)) + np.sin(phi).sum(axis=1)


def test_the_difference_is_the_quantile_of_what_two_previews_say_of_random_designs(
    scene: Scene,
) -> None:
    # Normal differences of deviation 3 are within 1.645 deviations nine times in ten.
    errors = 3.0 * np.random.default_rng(0).standard_normal(DESIGNS)
    found = preview_difference(scene, brightness, lambda a, b: brightness(a, b) + errors)
    spread_of_quantile = 3.0 * np.sqrt(COVERAGE * (1 - COVERAGE) / DESIGNS) / 0.206
    assert found == pytest.approx(1.645 * 3.0, abs=3 * spread_of_quantile)
    assert preview_difference(scene, brightness, brightness) == 0.0


def test_designs_have_the_scenes_lamps_and_one_color_each(scene: Scene) -> None:
    seen: list[np.ndarray] = []

    def scores(phi: np.ndarray, power: np.ndarray) -> np.ndarray:
        seen.extend([phi, power])
        return brightness(phi, power)

    preview_difference(scene, scores, scores)
    phi, power = seen[:2]
    assert phi.shape == (DESIGNS, scene.lamp_count)
    assert ((phi >= 0) & (phi <= np.pi)).all()
    assert power.shape == (DESIGNS, scene.lamp_count, len(scene.palette.channels))
    assert (power.sum(axis=-1) > 0).all()
    np.testing.assert_array_equal(seen[2], phi)
    np.testing.assert_array_equal(seen[3], power)


def test_flat_pads_with_a_diffuser_have_a_floor_of_their_own() -> None:
    bent = load_scene("finger20")
    flat = unchecked(bent, {"bending": unchecked(bent.bending, {"angles": (0.0,)})})
    assert followed_half_width(flat, 200.0, 500.0, 0.0, 0.0) == pytest.approx(
        200.0 * DIFFUSER_FLOOR
    )


def test_the_interval_grows_from_its_floor_to_a_share_of_the_difference(scene: Scene) -> None:
    floor = {"finger20": BENT_FLOOR, "digit": FLAT_FLOOR}[scene.name]
    assert followed_half_width(scene, 200.0, 500.0, 0.0, 0.0) == pytest.approx(200.0 * floor)
    far = 1e6
    found = followed_half_width(scene, 200.0, 500.0, far, 0.0)
    assert found == pytest.approx(far * DIFFERENCE_SHARE, rel=1e-6)
    widths = [followed_half_width(scene, 200.0, 500.0, one, 0.0) for one in (0, 1, 10, 100)]
    assert widths == sorted(set(widths))


def test_photon_noise_widens_the_interval_by_what_hues_weigh(scene: Scene) -> None:
    for lam in (500.0, 8000.0):
        noisy = [followed_half_width(scene, 200.0, lam, 10.0, one) for one in (0, 0.01, 0.03, 0.1)]
        assert noisy == sorted(set(noisy))
        far = followed_half_width(scene, 200.0, lam, 10.0, 10.0)
        assert far == pytest.approx(10.0 * HUE_SHARE * lam, rel=1e-3)


def test_photon_noise_widens_the_interval_where_hue_says_nothing(scene: Scene) -> None:
    still, noisy = (followed_half_width(scene, 200.0, 0.0, 0.0, one) for one in (0.0, 0.03))
    assert noisy**2 - still**2 == pytest.approx((200.0 * BRIGHTNESS_SHARE * 0.03) ** 2)
