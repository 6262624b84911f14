"""Images of lamps in a flat pad over facing walls: which, how likely, and what joining gives."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from render.cells.far_cells import FarCells, has_far_cells
from render.cells.fiber_light import FiberLight
from render.cells.lamp_cells import CELL_MAX, has_lamp_images
from render.cells.lamp_images import NO_IMAGE, LampImages
from render.cells.mirror_images import FoldedWay
from render.scene import Scene
from tests.oracles.pads import scene_of_case

COUNT = 2000


@pytest.fixture(
    scope="module",
    params=[
        "cast in",
        "cast in index 1.7",
        "cast in beside a clear rim index 1.7",
        "cast in between mirrors",
    ],
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


@pytest.mark.parametrize("later", [False, True])
def test_the_image_in_a_direction_is_the_one_that_a_line_to_it_was_drawn_for(
    mono: ModuleType, scene: Scene, later: bool
) -> None:
    """Places where a folded ray is after so many mm, mirror by mirror, are the lamp's own."""
    import mitsuba as mi

    images, rng = images_of(scene), np.random.default_rng(1)
    lamp = rng.integers(0, scene.lamp_count, COUNT).astype(np.uint32)
    image = drawn_images(images, lamp, later, rng)
    lamp, image = lamp[image != NO_IMAGE], image[image != NO_IMAGE]
    count = len(image)
    at = rng.uniform([-7, -9], [7, 9], (count, 2))
    a = np.column_stack([at, np.full(count, scene.pad.thickness)])
    pick, x, y = rng.random((3, count))
    direction, distance, _ = images.line(
        mi.UInt32(image), mi.UInt32(lamp), mi.Point3f(a.T), mi.Float(pick), mi.Point2f(x, y)
    )
    way = np.array(direction).T * np.array(distance)[:, None]
    found = met_along(images, scene, lamp, later, a, way)
    np.testing.assert_array_equal(found, image)
    low, high = scene.box.low, scene.box.high
    for start, full, number in zip(a[:50], way[:50], lamp[:50], strict=True):
        where = folded(low, high, start + full)
        middle = scene.placed_lamps()[number]
        rounding = 1e-3 + 1e-6 * np.linalg.norm(full)
        assert np.linalg.norm(where - middle.position) < 0.51 * middle.diameter + rounding


def met_along(
    images: LampImages, scene: Scene, lamp: np.ndarray, later: bool, a: np.ndarray, way: np.ndarray
) -> np.ndarray:
    """Return the images that lie on unfolded ways from ``a`` (mm), ``(n, 3)`` both."""
    import mitsuba as mi

    low, high = scene.box.low[2], scene.box.high[2]
    levels = np.abs(np.floor((a + way)[:, 2] / (high - low) - low / (high - low)))
    folded_way = FoldedWay(
        mi.Float(np.hypot(way[:, 0], way[:, 1])), mi.UInt32(levels.astype(np.uint32)), mi.UInt32(0)
    )
    found = images.along(
        mi.UInt32(lamp), mi.Bool(later), mi.Point3f(a.T), mi.Vector3f(way.T), folded_way
    )
    return np.array(found)


def folded(low: np.ndarray, high: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return where a point of the unfolded box lies in the box."""
    turns = (p - low) % (2 * (high - low))
    return np.asarray(low + np.minimum(turns, 2 * (high - low) - turns))


def drawn_images(
    images: LampImages, lamp: np.ndarray, later: bool, rng: np.random.Generator
) -> np.ndarray:
    """Return an image of each lamp for random numbers."""
    import mitsuba as mi

    numbers = [mi.Float(row) for row in rng.random((4, len(lamp)))]
    return np.array(images.drawn(mi.UInt32(lamp), mi.Bool(later), tuple(numbers)))


@pytest.mark.parametrize("later", [False, True])
def test_every_image_that_is_drawn_is_drawn_as_often_as_it_says(
    mono: ModuleType, scene: Scene, later: bool
) -> None:
    import mitsuba as mi

    images, count = images_of(scene), 2_000_000
    for lamp in range(scene.lamp_count):
        image = drawn_images(images, np.full(count, lamp), later, np.random.default_rng(lamp))
        found, times = np.unique(image[image != NO_IMAGE], return_counts=True)
        said = np.array(images.probability(mi.UInt32(lamp), mi.Bool(later), mi.UInt32(found)))
        often = times > 50
        z = (times - count * said)[often] / np.sqrt(count * said[often])
        assert np.abs(z).max() < 5.5
        assert abs(np.mean(z**2) - 1.0) < 5.0 * np.sqrt(2.0 / often.sum())
        # Rare ones are drawn as often as they say together.
        if not has_far_cells(scene):
            assert said.sum() == pytest.approx(1.0, abs=1e-4)
        assert said.sum() < 1.0 + 1e-5
        rare = count * said[~often].sum()
        unseen = count * (1.0 - said.sum())
        assert times[~often].sum() < rare + unseen + 5.0 * np.sqrt(rare + unseen)


@pytest.mark.parametrize("size", [(20.0, 24.0), (31.0, 11.0)])
def test_all_far_cells_together_are_drawn_once(mono: ModuleType, size: tuple[float, float]) -> None:
    """Ring r has first / r - first / (r + 1), so rings up to R have 1 - first / (R + 1)."""
    import mitsuba as mi

    scene = scene_of_case("cast in index 1.7")
    pad = scene.pad.model_copy(update={"width": size[0], "length": size[1]})
    first, last = 5, 60
    far = FarCells(scene.model_copy(update={"pad": pad}), first, {0: 0.7, -1: 0.3})
    x, y = (each.ravel().astype(float) for each in np.mgrid[-80:81, -80:81])
    chance = np.array(
        [far.probability(mi.Float(x), mi.Float(y), mi.Int32(z)) for z in (1, 0, -1, -2)]
    )
    assert not chance[[0, 3]].any()
    ring = np.maximum(np.abs(x), np.abs(y))
    assert not chance[:, ring < first].any()
    assert chance[:, ring <= last].sum() == pytest.approx(1.0 - first / (last + 1), rel=1e-5)
    # In mm, light there meets both pairs of walls at more than the angle of total reflection.
    steepest = np.maximum(np.abs(x) * size[0], np.abs(y) * size[1]) / np.hypot(
        x * size[0], y * size[1]
    ).clip(1.0)
    total = steepest < np.sqrt(1.0 - 1.7**-2.0)
    outer = (ring >= 40) & (ring <= last)
    assert (chance[1][outer & total] > 0.0).all()
    lost = outer & (steepest > np.sqrt(1.0 - 1.7**-2.0) + 0.03)
    assert not chance[1][lost].any()


def test_the_nearest_images_are_for_vertices_behind_the_facet(mono: ModuleType) -> None:
    images = images_of(scene_of_case("cast in index 1.7"))
    scene = scene_of_case("cast in index 1.7")
    over_one_wall, down = np.array([[15.0, 0.0, -5.0]]), np.array([[0.0, 2.0, -6.0]])
    lamp, a = np.zeros(1, dtype=np.uint32), np.array([[0.0, 0.0, 7.7]])
    for later in (False, True):
        aimed = met_along(images, scene, lamp, later, a, over_one_wall)
        assert (aimed[0] != NO_IMAGE) == later
        # The lamp itself is no image of it.
        assert met_along(images, scene, lamp, later, a, down)[0] == NO_IMAGE


@pytest.mark.parametrize(("case", "there"), [("cast in", False), ("cast in index 1.7", True)])
def test_far_images_are_those_of_an_index_above_the_root_of_two(case: str, there: bool) -> None:
    assert has_far_cells(scene_of_case(case)) == there


def test_images_carry_what_total_reflection_at_all_faces_leaves(mono: ModuleType) -> None:
    """With an index of 1.7 light at 45 deg to both walls loses nothing, however far it came."""
    import mitsuba as mi

    scene = scene_of_case("cast in index 1.7")
    images = images_of(scene)
    slanted, steep = np.array([0.7062, 0.7062, -0.05]), np.array([0.95, 0.308, -0.05])
    ways = np.linspace(30, 20 * CELL_MAX, 200)[:, None]
    lamp, a = np.zeros(len(ways), dtype=np.uint32), np.tile([0.0, 0.0, 7.7], (len(ways), 1))
    seen = []
    for direction in (slanted, steep):
        met = met_along(images, scene, lamp, False, a, ways * direction)
        known = mi.UInt32(met[met != NO_IMAGE])
        left = mi.Vector3f(*direction.tolist())
        seen.append(np.array(images.reflected(known, mi.Point3f(*a[0].tolist()), left)))
    assert len(seen[0]) > 20
    np.testing.assert_allclose(seen[0], 1.0, rtol=1e-4)
    assert (seen[1] < 0.1).all()
