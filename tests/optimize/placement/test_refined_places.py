"""Refined places end where symmetry and a fine scan have them, and within their rails."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from optimize.design import Array, Design, limits_of
from optimize.placement import candidates_of, refined_places, searched_scene
from optimize.scoring import TableScorer, scene_model, search_table
from render.scene import Scene, load_scene, scene_text
from render.scene.places import Place, rail_places


def quantity(value: object, unit: str = "mm") -> str:
    return f'{{ value = {value}, unit = "{unit}", source = "test" }}'


BASE = f'[[search.places]]\nedge = "base"\npitch = {quantity(4.0)}\n'


def digit_with(folder: Path, *lines: str) -> Scene:
    path = folder / "mine.toml"
    path.write_text(scene_text("digit") + "\n[search]\n" + "\n".join(lines) + "\n")
    return load_scene(path).with_(sites_columns=2, sites_rows=2)


def lit(scene: Scene, places: dict[int, int]) -> Design:
    """Return the design that lights candidates, by number, in colors."""
    colors = np.full(scene.lamp_count + len(candidates_of(scene)), -1)
    for place, color in places.items():
        colors[scene.lamp_count + place] = color
    return Design.of_colors(np.full(len(colors), math.pi / 2), colors)


def along_base(scene: Scene) -> Array:
    return np.array([one.position[0] for one in candidates_of(scene)])


def test_one_lamp_goes_to_the_middle_of_a_symmetric_pad(tmp_path: Path) -> None:
    scene = digit_with(tmp_path, "lamps = 1", BASE, f"between = {quantity([-5.3, 6.0])}")
    middle = int(np.abs(along_base(scene)).argmin())
    assert along_base(scene)[middle] == pytest.approx(0.35)
    design = lit(scene, {middle: 1})
    found = refined_places(scene, searched_scene(scene), design, "score")
    assert found is not None
    (number,) = np.flatnonzero(found.design.colors >= 0)
    place = found.scene.placed_lamps()[number].position
    assert abs(place[0]) < 0.1
    assert place[1:].tolist() == [-13.2, 3.075]
    assert found.after > found.before
    assert max(found.moved) == pytest.approx(abs(0.35 - place[0]), abs=1e-3)


def test_neighbors_that_share_a_place_between_them_both_stay_lit(tmp_path: Path) -> None:
    scene = digit_with(tmp_path, "lamps = 2", BASE, f"between = {quantity([-6.0, 6.0])}")
    found = refined_places(scene, searched_scene(scene), lit(scene, {1: 0, 2: 1}), "score")
    assert found is not None
    numbers = np.flatnonzero(found.design.colors >= 0)
    assert sorted(found.design.colors[numbers]) == [0, 1]
    places = [found.scene.placed_lamps()[i].position[0] for i in numbers]
    assert abs(places[0] - places[1]) > 1.0


def test_two_dies_of_a_scene_at_one_place_keep_their_lights(tmp_path: Path) -> None:
    between = f"between = {quantity([0.0, 6.0])}"
    text = digit_with(tmp_path, "lamps = 2", BASE, between) and (tmp_path / "mine.toml").read_text()
    (tmp_path / "mine.toml").write_text(text.replace("[7.4, -13.2", "[-7.4, -13.2"))
    scene = load_scene(tmp_path / "mine.toml").with_(sites_columns=2, sites_rows=2)
    design = lit(scene, {1: 0})
    design.drive[1, 2] = 1.0  # the first of the two dies, blue
    found = refined_places(scene, searched_scene(scene), design, "score", traced=True)
    assert found is not None
    assert found.design.colors[: scene.lamp_count].tolist() == [-1, 2, -1]
    assert np.flatnonzero(found.design.colors == 0).size == 1


@pytest.mark.slow
def test_two_colors_end_mirrored_where_a_scan_has_them(tmp_path: Path) -> None:
    scene = digit_with(tmp_path, "lamps = 2", BASE, f"between = {quantity([-6.0, 6.0])}")
    assert along_base(scene).tolist() == [-6.0, -2.0, 2.0, 6.0]
    design = lit(scene, {0: 0, 3: 1})
    found = refined_places(scene, searched_scene(scene), design, "score")
    assert found is not None
    numbers = np.flatnonzero(found.design.colors >= 0)
    left, right = (found.scene.placed_lamps()[i].position[0] for i in numbers)
    # The preview's texels are not mirrored.
    assert left == pytest.approx(-right, abs=0.2)
    across = np.arange(2.0, 6.01, 0.5)
    assert scene.search is not None
    rail, count = rail_places(scene, scene.search.places[0]), len(across)
    scanned = [rail.candidate(Place((float(x),), 3.075, 0.0)) for x in [*-across, *across]]
    drawn = searched_scene(scene, lamps=2, candidates=scanned)
    scorer = TableScorer(search_table(scene_model(drawn, coarse=True)), limits=limits_of(drawn))
    phi = np.full(drawn.lamp_count, math.pi / 2)
    colors = np.full((count, count, drawn.lamp_count), -1)
    for i, j in np.ndindex(count, count):
        colors[i, j, 3 + i], colors[i, j, 3 + count + j] = 0, 1
    values = scorer.scores(colors.reshape(count**2, -1), phi)
    best = np.unravel_index(values.argmax(), (count, count))
    assert 2.0 < across[best[0]] < 6.0
    assert (left, right) == pytest.approx((-across[best[0]], across[best[1]]), abs=0.5)
    assert found.after > values.max() * 0.995
    assert found.after > found.before


def test_what_rounds_have_in_common_is_drawn_alike(tmp_path: Path) -> None:
    scene = digit_with(tmp_path, "lamps = 2", BASE)
    light = []
    for count in (2, 3):
        drawn = searched_scene(scene, candidates=candidates_of(scene)[:count])
        table = search_table(scene_model(drawn, coarse=True))
        light.append(TableScorer(table).light(np.full(drawn.lamp_count, math.pi / 2))[:5])
    # But for the exposure, which is that of all lamps.
    assert np.allclose(light[0] / light[0].sum(), light[1] / light[1].sum(), rtol=1e-5)


def test_heights_and_tilts_move_where_the_rail_leaves_them_free(tmp_path: Path) -> None:
    free = (
        f"height_range = {quantity([1.0, 5.0])}",
        f"tilt_range = {quantity([-20.0, 40.0], 'deg')}",
        f"at = {quantity([0.0])}",
    )
    scene = digit_with(tmp_path, "lamps = 1", '[[search.places]]\nedge = "base"', *free)
    found = refined_places(scene, searched_scene(scene), lit(scene, {0: 1}), "score")
    assert found is not None
    (number,) = np.flatnonzero(found.design.colors >= 0)
    lamp = found.scene.placed_lamps()[number]
    assert lamp.position[0] == 0.0
    assert 1.0 <= lamp.position[2] <= 5.0
    assert -20.0 <= math.degrees(lamp.tilt) <= 40.0
    assert (lamp.position[2], lamp.tilt) != (3.075, 0.0)


def test_a_pair_stays_mirrored(tmp_path: Path) -> None:
    rail = '[[search.places]]\nedge = "left"\n' + f"pitch = {quantity(6.0)}\n"
    scene = digit_with(tmp_path, "lamps = 2", 'mirror = "x"', rail)
    menu = candidates_of(scene)
    assert [one.image for one in menu[:2]] == [False, True]
    found = refined_places(scene, searched_scene(scene), lit(scene, {0: 1, 1: 1}), "score")
    assert found is not None
    one, other = (found.scene.placed_lamps()[i] for i in np.flatnonzero(found.design.colors >= 0))
    assert np.allclose(one.position * [-1, 1, 1], other.position, atol=1e-9)
    assert one.position[1] != menu[0].position[1]
    assert limits_of(found.scene).fits(found.design.colors[None])[0]


def test_places_that_are_named_one_by_one_stay(tmp_path: Path) -> None:
    rail = f'[[search.places]]\nedge = "base"\nat = {quantity([-3.0, 3.0])}\n'
    scene = digit_with(tmp_path, "lamps = 1", rail)
    assert refined_places(scene, searched_scene(scene), lit(scene, {0: 1}), "score") is None
    own = Design.of_colors(np.full(5, math.pi / 2), [0, 1, 2, -1, -1])
    assert refined_places(scene, searched_scene(scene), own, "score") is None


@pytest.mark.parametrize("color", ["green-0603", "ws2812b-2020-green"])
def test_a_part_goes_to_the_middle_with_its_body(color: str, tmp_path: Path) -> None:
    rail = f"between = {quantity([-5.3, 6.0])}"
    scene = digit_with(tmp_path, 'parts = ["green-0603", "ws2812b-2020"]', "lamps = 1", BASE, rail)
    searched = searched_scene(scene)
    lamps, allowed = searched.placed_lamps(), limits_of(searched).allowed
    number = searched.palette.names.index(color)
    near = [abs(lamp.position[0]) + 9.0 * (lamp.position[1] > -13.0) for lamp in lamps]
    lit = int(np.where(allowed[:, number], near, np.inf).argmin())
    colors = np.full(len(lamps), -1)
    colors[lit] = number
    design = Design.of_colors(np.full(len(lamps), math.pi / 2), colors, searched.palette)
    found = refined_places(scene, searched, design, "score")
    assert found is not None
    (moved,) = np.flatnonzero(found.design.colors >= 0)
    after = found.scene.placed_lamps()[moved]
    assert abs(after.position[0]) < 0.1 < abs(lamps[lit].position[0])
    assert (after.diameter, after.profile) == (lamps[lit].diameter, lamps[lit].profile)
    assert found.scene.palette.names[found.design.colors[moved]] == color
    assert limits_of(found.scene).fits(found.design.colors[None])[0]


def test_what_shines_in_one_shot_does_so_at_its_new_place(tmp_path: Path) -> None:
    scene = digit_with(tmp_path, "lamps = 1", BASE, f"between = {quantity([-5.3, 6.0])}")
    searched = searched_scene(scene, shots=2)
    menu = along_base(scene)
    colors = np.full(searched.lamp_count, -1)
    colors[scene.lamp_count + int(np.abs(menu).argmin())] = searched.palette.index("green@1")
    phi = np.full(searched.lamp_count, math.pi / 2)
    design = Design.of_colors(phi, colors, searched.palette)
    found = refined_places(scene, searched, design, "sensor")
    assert found is not None
    assert found.scene.palette == searched.palette
    (number,) = np.flatnonzero(found.design.colors >= 0)
    assert searched.palette.names[found.design.colors[number]] == "green@1"
    assert found.after < found.before


def test_traced_light_gets_places_around_that_are_not_lit_together(tmp_path: Path) -> None:
    scene = digit_with(tmp_path, "lamps = 2", BASE, f"between = {quantity([-5.3, 6.0])}")
    middle = int(np.abs(along_base(scene)).argmin())
    searched = searched_scene(scene)
    found = refined_places(scene, searched, lit(scene, {middle: 1}), "score", traced=True)
    assert found is not None
    (number,) = np.flatnonzero(found.design.colors >= 0)
    lamps = found.scene.placed_lamps()
    at = lamps[number].position[0]
    places = {round(lamp.position[0] - at, 6) for lamp in lamps if lamp.position[1] < -13.0}
    assert {0.0, 1.0, -1.0, 2.0, -2.0} <= places
    assert {round(x - at, 6) for x in along_base(scene)} <= places
    limits = limits_of(found.scene)
    pairs = np.array([(i, j) for i in range(3, len(lamps)) for j in range(3, i)])
    both = np.full((len(pairs), len(lamps)), -1)
    both[np.arange(len(pairs)), pairs[:, 0]], both[np.arange(len(pairs)), pairs[:, 1]] = 1, 2
    apart = [np.linalg.norm(lamps[i].position - lamps[j].position) for i, j in pairs]
    kept = np.array(apart) >= lamps[number].diameter - 1e-6
    assert limits.fits(both).tolist() == kept.tolist()
    assert not kept.all()
