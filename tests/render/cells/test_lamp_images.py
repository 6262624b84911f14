"""Images of lamps in a flat pad over facing walls: which, how likely, and what joining gives."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from render.cells.fiber_light import FiberLight
from render.cells.lamp_images import CELL_MAX, SLOTS, LampImages, has_lamp_images
from render.scene import Scene
from tests.oracles.pads import scene_of_case

COUNT = 2000


@pytest.fixture(
    scope="module",
    params=["cast in index 1.7", "cast in beside a clear rim index 1.7", "cast in between mirrors"],
)
def scene(request: pytest.FixtureRequest) -> Scene:
    return scene_of_case(request.param)


def images_of(scene: Scene) -> LampImages:
    return LampImages(scene, FiberLight(scene, np.zeros((scene.lamp_count, 1)), 0.0))


@pytest.mark.parametrize(
    ("case", "there"),
    [
        ("cast in", True),
        ("row cast in", True),
        ("smooth", False),
        ("cast in rough 0.1", False),
        ("cast in no face", False),
    ],
)
def test_smooth_walls_that_face_each_other_show_lamps_in_the_pad_over_and_over(
    case: str, there: bool
) -> None:
    assert has_lamp_images(scene_of_case(case)) == there


def test_the_image_in_a_direction_is_the_one_that_a_line_to_it_was_drawn_for(
    mono: ModuleType, scene: Scene
) -> None:
    """Places where a folded ray is after so many mm, mirror by mirror, are the lamp's own."""
    import mitsuba as mi

    images, rng = images_of(scene), np.random.default_rng(1)
    count = int(np.array(images.none)[0])
    entry = rng.integers(0, count, COUNT).astype(np.uint32)
    at = rng.uniform([-7, -9], [7, 9], (COUNT, 2))
    a = np.column_stack([at, np.full(COUNT, scene.pad.thickness)])
    # One lamp after another has the same cells.
    lamp = entry // (count // scene.lamp_count)
    pick, x, y = rng.random((3, COUNT))
    direction, distance, _ = images.line(
        mi.UInt32(entry), mi.UInt32(lamp), mi.Point3f(a.T), mi.Float(pick), mi.Point2f(x, y)
    )
    way = np.array(direction).T * np.array(distance)[:, None]
    found = np.array(images.along(mi.UInt32(lamp), mi.Point3f(a.T), mi.Vector3f(way.T)))
    kept = found != count
    assert 0.02 < kept.mean() <= 1.0
    np.testing.assert_array_equal(found[kept], entry[kept])
    low, high = scene.box.low, scene.box.high
    for start, full, number in zip(a[:50], way[:50], lamp[:50], strict=True):
        where = folded(low, high, start + full)
        middle = scene.placed_lamps()[number]
        assert np.linalg.norm(where - middle.position) < 0.51 * middle.diameter + 1e-3


def folded(low: np.ndarray, high: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return where a point of the unfolded box lies in the box."""
    turns = (p - low) % (2 * (high - low))
    return np.asarray(low + np.minimum(turns, 2 * (high - low) - turns))


def test_every_image_that_is_drawn_is_drawn_as_often_as_it_says(
    mono: ModuleType, scene: Scene
) -> None:
    import mitsuba as mi

    images = images_of(scene)
    number = (np.arange(SLOTS) + 0.5) / SLOTS
    for lamp in range(scene.lamp_count):
        entry = images.drawn(mi.UInt32(np.full(len(number), lamp)), mi.Float(number))
        found, times = np.unique(np.array(entry), return_counts=True)
        said = np.array(images.probability(mi.UInt32(found)))
        np.testing.assert_allclose(times / len(number), said, atol=1e-6)
        assert said.sum() == pytest.approx(1.0)


def test_images_carry_what_total_reflection_at_all_faces_leaves(mono: ModuleType) -> None:
    """With an index of 1.7 light at 45 deg to both walls loses nothing, however far it came."""
    import mitsuba as mi

    images = images_of(scene_of_case("cast in index 1.7"))
    slanted = mi.Vector3f([0.7062], [0.7062], [-0.05])
    steep = mi.Vector3f([0.95], [0.308], [-0.05])
    a = mi.Point3f(0.0, 0.0, 7.7)
    seen = []
    for direction in (slanted, steep):
        entry = [
            images.along(mi.UInt32(0), a, mi.Float([way]) * direction)
            for way in np.linspace(30, 20 * CELL_MAX, 200)
        ]
        known = [each for each in entry if int(each[0]) != int(images.none[0])]
        seen.append([float(images.reflected(each, direction)[0]) for each in known])
    assert len(seen[0]) > 20
    np.testing.assert_allclose(seen[0], 1.0, rtol=1e-4)
    assert all(value < 0.1 for value in seen[1])
