"""Rings, boards and lists give places as edges do: where and as they say, with their images."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from render.errors import SceneError
from render.scene import Rail, Scene, Search, load_scene, scene_text, unchecked
from render.scene.places import KeepOut, candidates_on, image_of, images

DIGIT = load_scene("digit")
BOARD = ((-6.0, -5.0), (6.0, -5.0), (6.0, 5.0), (-6.0, 5.0))


def rail(**keys: object) -> Rail:
    return Rail.model_construct(**keys)


def searching(**keys: object) -> Scene:
    return unchecked(DIGIT, {"search": Search.model_construct(**keys)})


def test_a_ring_is_divided_evenly_and_shines_to_its_middle() -> None:
    found = candidates_on(DIGIT, [rail(radius=6.0, center=(1.0, -2.0), heights=(-4.0,), pitch=3.0,
                                       tilt=math.radians(60.0))])  # fmt: skip
    assert len(found) == math.floor(2 * math.pi * 6.0 / 3.0)
    spokes = np.array([one.position for one in found]) - [1.0, -2.0, -4.0]
    assert np.linalg.norm(spokes, axis=1) == pytest.approx(6.0, abs=1e-3)
    chords = np.linalg.norm(spokes - np.roll(spokes, 1, axis=0), axis=1)
    assert np.ptp(chords) < 1e-3
    for spoke, one in zip(spokes, found, strict=True):
        # Seen from the place, the axis of the ring lies ahead, 60 deg up.
        assert one.direction[2] == pytest.approx(math.sin(math.radians(60.0)))
        assert np.cross(one.direction, spoke)[2] == pytest.approx(0.0, abs=1e-3)
        assert one.direction @ spoke < 0.0


def test_a_part_of_a_ring_keeps_between_its_angles() -> None:
    ends = math.radians(-30.0), math.radians(75.0)
    found = candidates_on(DIGIT, [rail(radius=8.0, heights=(-3.0,), angles=ends, pitch=2.0,
                                       direction=(0.0, 0.0, 2.0))])  # fmt: skip
    angles = [math.atan2(one.position[1], one.position[0]) for one in found]
    assert len(found) == math.floor(8.0 * (ends[1] - ends[0]) / 2.0) + 1
    assert np.diff(angles) == pytest.approx(2.0 / 8.0, abs=1e-3)
    assert ends[0] - 1e-3 <= min(angles) <= max(angles) <= ends[1] + 1e-3
    assert {tuple(one.direction) for one in found} == {(0.0, 0.0, 1.0)}


def test_a_board_holds_as_many_bodies_as_a_counter_finds() -> None:
    triangle = ((-6.0, -5.0), (6.0, -5.0), (0.0, 7.0))
    found = candidates_on(DIGIT, [rail(corners=triangle, heights=(-2.0,), pitch=1.5)])
    radius = 0.65
    # Away from the three sides by half planes, which no polygon code knows.
    counted, steps = 0, math.floor((12.0 - 1.3) / 1.5)
    slope = math.hypot(12.0, 6.0)
    for row in range(steps + 1):
        for column in range(steps + 1):
            x, y = (column - steps / 2) * 1.5, 1.0 + (row - steps / 2) * 1.5
            sides = (42.0 - 12.0 * x - 6.0 * y) / slope, (42.0 + 12.0 * x - 6.0 * y) / slope
            counted += min(y + 5.0, *sides) >= radius
    assert len(found) == counted > 10
    assert {one.position[2] for one in found} == {-2.0}
    assert {tuple(one.direction) for one in found} == {(0.0, 0.0, 1.0)}


def test_a_list_is_as_it_is_written() -> None:
    found = candidates_on(DIGIT, [rail(positions=((-12.0, 3.0, 2.0), (3.0, 4.0, -3.0)),
                                       directions=((2.0, 0.0, 0.0), (0.0, 3.0, 4.0)))])  # fmt: skip
    assert [one.position.tolist() for one in found] == [[-12.0, 3.0, 2.0], [3.0, 4.0, -3.0]]
    assert [one.direction.tolist() for one in found] == [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]


def test_the_lens_of_the_camera_is_kept_free() -> None:
    board = rail(corners=BOARD, heights=(-2.0,), pitch=1.5)
    whole = candidates_on(DIGIT, [board])
    lens = KeepOut.model_construct(center=(0.0, 0.0), radius=3.0)
    around = candidates_on(searching(keep_out=(lens,)), [board])
    away = [np.hypot(*one.position[:2]) for one in whole]
    assert len(around) == sum(distance >= 3.0 + 0.65 for distance in away) < len(whole)
    half = KeepOut.model_construct(corners=((0.0, -9.0), (9.0, -9.0), (9.0, 9.0), (0.0, 9.0)))
    left = candidates_on(searching(keep_out=(half,)), [board])
    assert len(left) == sum(one.position[0] <= -0.65 for one in whole)


@pytest.mark.parametrize("mirror", ["x", "y"])
def test_every_place_has_its_image_although_rails_lie_on_one_side(mirror: str) -> None:
    axis = "xy".index(mirror)
    scene = searching(mirror=mirror)
    edge = "left" if mirror == "x" else "tip"
    one_sided = rail(positions=((3.0, 4.0, -3.0),), directions=((0.3, 0.4, 1.0),))
    found = candidates_on(scene, [rail(edge=edge), one_sided])
    assert len(found) > 8
    places = {tuple(one.position) for one in found} | {
        tuple(lamp.position) for lamp in DIGIT.placed_lamps()
    }
    for one in found:
        other = one.position.copy()
        other[axis] = 0.0 - other[axis]
        assert tuple(other) in places
    image = image_of(found[-2], "x" if mirror == "x" else "y")
    assert image.position.tolist() == found[-1].position.tolist()
    assert image.direction.tolist() == found[-1].direction.tolist()


def test_bodies_that_would_fall_on_their_images_are_left_out() -> None:
    board = rail(corners=BOARD, heights=(-2.0,), pitch=0.9)
    across = [one.position[0] for one in candidates_on(searching(mirror="x"), [board])]
    assert all(abs(x) < 1e-9 or abs(x) >= 0.65 for x in across)
    assert len(across) % 2 == sum(abs(x) < 1e-9 for x in across) % 2


def test_lamps_of_a_sensor_are_told_their_images() -> None:
    assert images(DIGIT.placed_lamps(), "x") == (0, 2, 1)
    assert images(DIGIT.placed_lamps(), "y") == (None, None, None)


def quantity(value: object, unit: str = "mm") -> str:
    return f'{{ value = {value}, unit = "{unit}", source = "test" }}'


HEIGHT = f"heights = {quantity([-2.0])}"
SQUARE = f"corners = {quantity([list(corner) for corner in BOARD])}"


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (("like = 0",), "search.places.0 says not where lamps may sit, allowed: one of edge, "
         "radius, corners, positions"),
        (('edge = "left"', f"radius = {quantity(3.0)}"),
         "search.places.0 names edge and radius, allowed: one of"),
        ((f"radius = {quantity(0.0)}", HEIGHT),
         "search.places.0.radius = 0.0: allowed: 0.05 to 100 mm"),
        ((f"radius = {quantity('nan')}", HEIGHT), "search.places.0.radius = nan: allowed: 0.05"),
        ((f"radius = {quantity(3.0)}",), "missing key search.places.0.heights"),
        ((f"radius = {quantity(3.0)}", HEIGHT, f"gap = {quantity(1.0)}"),
         "search.places.0.gap: a ring has none, allowed: angles, center,"),
        ((f"radius = {quantity(3.0)}", HEIGHT, f"angles = {quantity([0.0, 400.0], 'deg')}"),
         "search.places.0.angles"),
        ((f"radius = {quantity(3.0)}", HEIGHT, f"angles = {quantity([-200.0, 200.0], 'deg')}"),
         "search.places.0.angles go around more than once, allowed: at most 360 deg"),
        ((f"radius = {quantity(6.0)}", f"heights = {quantity([5.9])}"),
         "search.places.0, a ring of 6 mm about (0, 0) mm: a lamp at (6, 0, 5.9) mm is inside the "
         "pad, but its end"),
        ((f"radius = {quantity(9.5)}", f"heights = {quantity([3.0])}"),
         "search.places.0, a ring of 9.5 mm about (0, 0) mm: a lamp at"),
        ((f"corners = {quantity([[0.0, 0.0], [3.0, 3.0]])}", HEIGHT),
         "search.places.0.corners has 2 corners, allowed: 3 to 64, going around"),
        ((f"corners = {quantity([[0.0, 0.0], [3.0, 3.0], [3.0, 0.0], [0.0, 3.0]])}", HEIGHT),
         "search.places.0.corners: the sides after corners 0 and 2 meet, allowed: corners in "
         "their order around it"),
        ((f"corners = {quantity([[0.0, 0.0], [3.0, 3.0], [6.0, 6.0]])}", HEIGHT),
         "search.places.0.corners enclose no area"),
        ((f"corners = {quantity([[0.0, 0.0], [3.0], [6.0, 1.0]])}", HEIGHT),
         "search.places.0.corners.1 = [3.0]: allowed: 2 numbers"),
        ((f"corners = {quantity([[-900.0, -900.0], [900.0, 900.0], [900.0, 899.0]])}", HEIGHT,
          f"pitch = {quantity(0.05)}"),
         "search.places.0 looks at 1,296,072,001 places, allowed: at most 20,000; take a larger"),
        ((f"corners = {quantity([[0.0, float(i)] for i in range(65)])}", HEIGHT),
         "search.places.0.corners has 65 corners, allowed: 3 to 64"),
        ((f"corners = {quantity([[0.0, 0.0], [0.5, 0.0], [0.5, 0.5]])}", HEIGHT),
         "search.places.0: no lamp fits on a board, allowed: room for at least a lamp"),
        ((SQUARE, HEIGHT, f"tilt = {quantity(3.0, 'deg')}"),
         "search.places.0.tilt: a board has none"),
        ((SQUARE, f"heights = {quantity([-0.05])}", 'direction = { value = [1.0, 0.0, 0.0], '
          'source = "test" }'), "search.places.0, a board: a lamp at"),
        ((SQUARE, HEIGHT, 'direction = { value = [0.0, 0.0, 0.0], source = "test" }'),
         "search.places.0.direction = 0, 0, 0, allowed: x, y and z, not all 0"),
        ((f"positions = {quantity([[12.0, 0.0, 3.0]])}", 'directions = { value = [[-1.0, 0.0, '
          '0.0], [1.0, 0.0, 0.0]], source = "test" }'),
         "search.places.0: 1 positions and 2 directions, allowed: as many of both"),
        (('edge = "left"', f"height_range = {quantity([3.0, 1.0])}"),
         "search.places.0.height_range = 3, 1 mm, allowed: two ends, ascending"),
        (('edge = "left"', HEIGHT, f"height_range = {quantity([1.0, 3.0])}"),
         "search.places.0.heights = -2 mm lies outside of height_range, allowed: 1 to 3 mm"),
        (('edge = "left"', f"tilt = {quantity(9.0, 'deg')}",
          f"tilt_range = {quantity([10.0, 30.0], 'deg')}"),
         "search.places.0.tilt = 9 deg lies outside of tilt_range, allowed: 10 to 30 deg"),
        (('edge = "left"', f"height_range = {quantity([1.0, 9.0])}"),
         "search.places.0.height_range, the left edge: a lamp at z = 9 mm lies above the pad"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_one_sentence_with_its_key(
    lines: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    path = tmp_path / "mine.toml"
    section = "\n".join(("", "[[search.places]]", *lines, ""))
    path.write_text(scene_text("digit") + section)
    with pytest.raises(SceneError) as refused:
        load_scene(path)
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (('mirror = "z"',), 'search.mirror = "z", allowed: "x" or "y"'),
        (('mirror = "y"',), "but no lamp has an image at y = 0, allowed: search.places, or lamps"),
        (('mirror = "x"', "[[search.places]]", f"positions = {quantity([[0.3, 12.0, -4.0]])}",
          'directions = { value = [[0.0, -1.0, 1.0]], source = "test" }'),
         "search.places.0: mirrored at x = 0 its places fall on each other, 0.6 mm apart, "
         "allowed: at least 1.3 mm, or places on x = 0 that shine along it"),
        (("[[search.keep_out]]", 'edge = "left"'), "search.keep_out.0 names edge, allowed: edge "
         "and between, center and radius, or corners"),
        (("[[search.keep_out]]", f"center = {quantity([0.0])}", f"radius = {quantity(1.0)}"),
         "search.keep_out.0.center has 1 numbers, allowed: x and y"),
    ],
)  # fmt: skip
def test_mirrors_and_keep_outs_that_cannot_be_are_refused(
    lines: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(scene_text("digit") + "\n[search]\n" + "\n".join(lines) + "\n")
    with pytest.raises(SceneError) as refused:
        load_scene(path)
    assert said in str(refused.value)


@pytest.mark.parametrize("image", [-1.0, 1.0])
def test_a_rail_through_the_gel_is_refused_on_either_side(image: float, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    inside = f"positions = {quantity([[image * 9.0, 9.0, 3.0]])}"
    way = f'directions = {{ value = [[{-image}, 0.0, 1.0]], source = "test" }}'
    lines = "\n".join(("", "[search]", 'mirror = "x"', "[[search.places]]", inside, way, ""))
    path.write_text(scene_text("digit") + lines)
    with pytest.raises(SceneError, match=r"search.places.0, a list: a lamp at .* mm"):
        load_scene(path)
