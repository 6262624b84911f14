"""Images through the bond of a window, and over its lower face: choice, way and light."""

from __future__ import annotations

from types import ModuleType

import drjit as dr
import numpy as np
import pytest
from scipy.optimize import brentq

from render.cells.bonded_images import BondedImages
from render.scene import Scene
from tests.oracles.pads import scene_of_case
from tests.render.cells.test_box_images import A, Y, connected, on_coating

CASES = ["window lit at its edges", "window of low index"]


@pytest.mark.parametrize("case", CASES)
def test_images_are_drawn_with_the_probability_that_is_stated(mono: ModuleType, case: str) -> None:
    images, count = BondedImages(scene_of_case(case)), 1 << 16
    a, y = on_coating(mono, A, count), on_coating(mono, Y, count)
    number = mono.Float(np.random.default_rng(3).random(count).astype(np.float32))
    drawn, stated = (np.array(each) for each in images.draw(a, y, number))
    total = 0.0
    for image in range(images.count):
        here = images.probability(mono.UInt32(image), on_coating(mono, A), on_coating(mono, Y))
        probability = float(dr.slice(here))
        total += probability
        error = np.sqrt(probability * (1 - probability) / count)
        assert abs((drawn == image).mean() - probability) < 4.5 * error + 1e-5
        np.testing.assert_allclose(stated[drawn == image], probability, rtol=1e-4)
    assert total == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize("case", CASES)
def test_light_over_the_lower_face_is_what_snell_and_fresnel_say(
    mono: ModuleType, case: str
) -> None:
    scene = scene_of_case(case)
    count = 1 << 14
    values = connected(mono, scene, BondedImages(scene), count)
    half = np.array([scene.pad.width, scene.pad.length]) / 2
    assert scene.window is not None
    total = 0.0
    for x in (Y[0], -2 * half[0] - Y[0], 2 * half[0] - Y[0]):
        for along in (Y[1], -2 * half[1] - Y[1], 2 * half[1] - Y[1]):
            # Without the lower face the way would lie in the coating.
            total += carried(
                scene, np.array([x, along]) - A[:2], half, 2 * A[2], 2 * scene.window.thickness
            )
    error = values.std() / np.sqrt(count)
    assert error < 0.02 * total
    assert abs(values.mean() - total) < 4 * error + 1e-3 * total


@pytest.mark.parametrize("case", CASES)
def test_paint_around_the_window_is_seen_through_the_bond_and_over_the_lower_face(
    mono: ModuleType, case: str
) -> None:
    """It is paint on the base, at -12 mm, of which no wall but the others shows images."""
    scene = scene_of_case(case)
    assert scene.window is not None
    count, thickness = 1 << 14, scene.window.thickness
    place = [-6.0, -11.99, -1.2]
    values = connected(mono, scene, BondedImages(scene), count, place, (0.0, 1.0, 0.0))
    half = np.array([scene.pad.width, scene.pad.length]) / 2
    total = 0.0
    for x in (place[0], -2 * half[0] - place[0], 2 * half[0] - place[0]):
        for along in (place[1], 2 * half[1] - place[1]):
            for down in (-place[2], 2 * thickness + place[2]):
                across = np.array([x, along]) - A[:2]
                total += carried(scene, across, half, A[2], down, base=True)
    error = values.std() / np.sqrt(count)
    assert error < 0.02 * total
    assert abs(values.mean() - total) < 4 * error + 1e-3 * total


def carried(
    scene: Scene, across: np.ndarray, half: np.ndarray, up: float, down: float, base: bool = False
) -> float:
    """Return the light between two diffuse points, ``across`` (mm) in the unfolded pad.

    It goes through ``up`` mm of the pad and ``down`` mm of the window, to the skin or to paint on
    the ``base`` around the window.
    """
    assert scene.window is not None
    pad, window = scene.pad.index, scene.window.index
    reach = float(np.hypot(*across))

    def lateral(angle: float) -> float:
        sine = pad * np.sin(angle) / window
        return float(up * np.tan(angle) + down * sine / np.sqrt(1 - sine**2))

    last = np.arcsin(min(1.0, window / pad))
    angle = brentq(lambda t: lateral(t) - reach, 0.0, last - 1e-9, xtol=1e-14)
    step = 1e-6
    slope = (lateral(angle + step) - lateral(angle - step)) / (2 * step)
    within = np.arcsin(pad * np.sin(angle) / window)
    passed = 1 - fresnel(np.cos(angle), pad / window)
    area = reach * slope / np.sin(angle)
    if base:
        # Per solid angle in the window.
        spread = area * np.cos(within) * (window / pad) ** 2
        arriving = abs(across[1]) / reach * np.sin(within)
        over_lower = down > scene.window.thickness
        light = passed * (fresnel(np.cos(within), window) if over_lower else 1.0)
        crossed = (up * np.tan(angle), reach)
    else:
        spread, arriving = area * np.cos(angle), np.cos(angle)
        light = passed**2 * fresnel(np.cos(within), window)
        crossed = (0.5 * up * np.tan(angle), 0.5 * up * np.tan(angle) + down * np.tan(within))
    # Walls reflect in the medium in which they are met.
    for axis in (0, 1):
        wall = np.sign(across[axis]) * half[axis] - A[axis]
        if abs(across[axis]) > abs(wall):
            part = across[axis] / reach
            in_window = crossed[0] < wall / part < crossed[1]
            sine = np.sin(within if in_window else angle)
            light *= fresnel(abs(part * sine), window if in_window else pad)
    return float((0.5 / np.pi) ** 2 * np.cos(angle) * arriving * light / spread)


def fresnel(cosine: float, index: float) -> float:
    """Return what a face reflects on its dense side if ``index`` is above 1."""
    squared = 1 - index**2 * (1 - cosine**2)
    if squared <= 0:
        return 1.0
    out = np.sqrt(squared)
    s = (index * cosine - out) / (index * cosine + out)
    p = (cosine - index * out) / (cosine + index * out)
    return float((s**2 + p**2) / 2)


@pytest.mark.parametrize("case", CASES)
def test_ways_are_exact_near_the_bond_and_far_along_it(mono: ModuleType, case: str) -> None:
    scene, count = scene_of_case(case), 400
    assert scene.window is not None
    pad, window, down = scene.pad.index, scene.window.index, 2 * scene.window.thickness
    images, rng = BondedImages(scene), np.random.default_rng(5)
    a, p = (
        np.column_stack([rng.uniform(-10, 10, (count, 2)), rng.choice([0.03, 1.0, 4.5], count)])
        for _ in range(2)
    )
    places = (mono.Point3f(*each.T.astype(np.float32)) for each in (a, p))
    # The lower face alone.
    direction, spread = images.line(mono.UInt32(9), *places)
    sine = np.hypot(*np.array(direction, dtype=np.float64)[:2])
    for i in range(count):
        reach, up = np.hypot(*(p - a)[i, :2]), a[i, 2] + p[i, 2]

        def beyond(s: float, up: float = up, reach: float = reach) -> float:
            within = pad * s / window
            lateral = up * s / np.sqrt(1 - s**2) + down * within / np.sqrt(1 - within**2)
            return float(lateral - reach)

        last = min(1.0, window / pad) * (1 - 1e-13)
        s = brentq(beyond, 0.0, last, xtol=1e-16)
        assert sine[i] == pytest.approx(s, abs=1e-5)
        cosine, within = np.sqrt(1 - s**2), np.sqrt(1 - (pad * s / window) ** 2)
        across = up / cosine + down * pad / window / within
        slope = up / cosine**2 + down * pad * cosine / (window * within**3)
        assert float(np.array(spread)[i]) == pytest.approx(across * cosine * slope, rel=1e-4)
