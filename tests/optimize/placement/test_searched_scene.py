"""The scene that is searched has the sensor's own lamps first, and places that change no light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from optimize.design import DARK, baseline_design, limits_of
from optimize.placement import searched_scene
from optimize.readers import CameraModel
from optimize.scoring import TableScorer, open_model, search_table
from optimize.search import ReaderObjective
from render.errors import SceneError
from render.preview import Preview
from render.scene import load_scene, scene_text, shipped_scenes, standalone


@pytest.mark.parametrize("name", shipped_scenes())
def test_own_lamps_keep_their_numbers_and_the_baseline_is_the_same(name: str) -> None:
    scene = load_scene(name)
    searched = searched_scene(scene)
    count = scene.lamp_count
    own = searched.placed_lamps()[:count]
    assert [lamp.key for lamp in own] == [lamp.key for lamp in scene.placed_lamps()]
    assert np.array_equal(
        [lamp.position for lamp in own], [lamp.position for lamp in scene.placed_lamps()]
    )
    colors = baseline_design(searched).colors
    assert np.array_equal(colors[:count], baseline_design(scene).colors)
    assert (colors[count:] == DARK).all()


def test_its_file_is_read_again_and_keeps_the_comments(tmp_path: Path) -> None:
    searched = searched_scene(load_scene("digit"))
    text = standalone(searched).text
    (tmp_path / "kept.toml").write_text(text)
    again = load_scene(tmp_path / "kept.toml")
    assert again == searched
    assert again.hash == searched.hash
    comments = [line for line in scene_text("digit").splitlines() if line.startswith("#")]
    assert all(line in text.splitlines() for line in comments)


def test_places_that_are_off_change_no_light() -> None:
    scene = load_scene("digit").with_(sites_columns=2, sites_rows=2)
    searched = searched_scene(scene)
    bends = np.array([0.0])
    with Preview(scene) as alone, Preview(searched) as among:
        own = alone.transport(np.full(1, np.pi / 2), bends)[0]
        all_of_them = among.transport(np.full(1, np.pi / 2), bends)[0]
    assert np.allclose(all_of_them[:3], own, rtol=1e-5, atol=1e-9 * own.max())


def test_the_leds_are_those_that_the_baseline_lights() -> None:
    limits = limits_of(searched_scene(load_scene("digit")))
    assert limits.most_lit == 3
    assert limits.led_counts.tolist() == [1, 1, 1, 34]
    fewer = limits_of(searched_scene(load_scene("gelsight-mini"), lamps=6))
    assert fewer.most_lit == 6
    assert fewer.led_counts[:3].tolist() == [4, 4, 3]
    more = limits_of(searched_scene(load_scene("digit"), lamps=5))
    assert more.most_lit == 5
    assert (more.led_counts == 34).all()


def test_limits_of_the_file_stay(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(scene_text("digit") + "[constraints]\nmax_blue = 2\n[search]\nlamps = 2\n")
    limits = limits_of(searched_scene(load_scene(path)))
    assert limits.most_lit == 2
    assert limits.led_counts.tolist() == [34, 34, 2, 34]


def test_without_places_only_the_number_is_limited() -> None:
    scene = load_scene("finger20")
    searched = searched_scene(scene, place=False, lamps=6)
    assert searched.hash == scene.hash
    assert limits_of(searched).most_lit == 6
    assert (limits_of(searched).led_counts == 20).all()


def test_lamps_of_a_table_become_listed_ones(tmp_path: Path) -> None:
    text = scene_text("digit")
    head, tail = text[: text.index("[[lamps]]")], text[text.index("[camera]") :]
    head = head.replace("schema = 2", 'schema = 2\nlamps_file = "two.csv"')
    (tmp_path / "mine.toml").write_text(head + tail)
    (tmp_path / "two.csv").write_text(
        "x,y,z,direction_x,direction_y,direction_z,diameter,profile\n"
        "-7.4,-13.2,3.075,0,1,0,1.3,lambertian\n7.4,-13.2,3.075,0,1,0,1.3,lambertian\n"
    )
    scene = load_scene(tmp_path / "mine.toml")
    assert searched_scene(scene).hash == searched_scene(load_scene("digit")).hash


@pytest.mark.parametrize("lamps", [0, 35])
def test_more_lamps_than_there_are_places_are_refused(lamps: int) -> None:
    with pytest.raises(SceneError, match="allowed: 1 to 34, as many as digit has with its places"):
        searched_scene(load_scene("digit"), lamps=lamps)


def test_a_sensor_without_room_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    quantity = '{ value = [0.0], unit = "mm", source = "test" }'
    path.write_text(scene_text("digit") + f'[[search.places]]\nedge = "tip"\nat = {quantity}\n')
    with pytest.raises(SceneError, match="no place for a lamp along its edges that is not taken"):
        searched_scene(load_scene(path))


def test_places_mirrored_read_alike() -> None:
    scene = searched_scene(load_scene("digit"))
    position = np.array([lamp.position for lamp in scene.placed_lamps()])
    away = np.linalg.norm(position[:, None] * [-1, 1, 1] - position, axis=-1)
    mirrored = away.argmin(axis=1)
    assert away.min(axis=1).max() == 0.0
    scorer = TableScorer(
        search_table(open_model(scene, None, coarse=True)), limits=limits_of(scene)
    )
    goal = ReaderObjective(scorer, scene, "sensor", CameraModel.of(scene))
    rng, phi = np.random.default_rng(3), np.full(scene.lamp_count, np.pi / 2)
    for _ in range(4):
        colors = scorer.limits.nearest_colors(rng.uniform(size=scorer.limits.allowed.shape))
        one, other = (scorer.design(phi, colors[order]) for order in (slice(None), mirrored))
        # The preview's texels are not mirrored.
        assert goal.value(one) == pytest.approx(goal.value(other), rel=0.04)


def test_shots_are_searched_beside_places() -> None:
    scene = load_scene("digit")
    shots = searched_scene(scene, place=False, shots=2)
    assert (shots.name, shots.palette.shots, shots.lamp_count) == ("digit-shots", 2, 3)
    assert shots.hash == scene.with_(camera_shots=2).hash
    assert searched_scene(scene, place=False, shots=1).hash == scene.hash
    placed = searched_scene(scene, shots=2)
    assert (placed.name, placed.palette.shots) == ("digit-shots-places", 2)
    # One LED of each color, whatever its shots.
    assert limits_of(placed).led_counts.tolist() == [1, 1, 1, 34]
    colors = [placed.palette.index(name) for name in ("red@1", "red@2")]
    both = np.full(placed.lamp_count, DARK)
    both[:2] = colors
    assert not limits_of(placed).fits(both[None])[0]
    with pytest.raises(SceneError, match=r"camera.shots = 5: allowed: 1 to 4"):
        searched_scene(scene, shots=5)


def mirrored_digit(folder: Path, *lines: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(scene_text("digit") + '[search]\nmirror = "x"\n' + "\n".join(lines) + "\n")
    return path


def test_mirrored_lamps_are_lit_together_and_alike(tmp_path: Path) -> None:
    path = mirrored_digit(tmp_path, "lamps = 4", '[[search.places]]\nedge = "left"')
    scene = searched_scene(load_scene(path))
    limits, lamps = limits_of(scene), scene.placed_lamps()
    position = np.array([lamp.position for lamp in lamps])
    rng = np.random.default_rng(2)
    for _ in range(10):
        colors = limits.nearest_colors(rng.uniform(size=limits.allowed.shape))
        assert 0 < (colors >= 0).sum() <= 4
        for place, color in zip(position, colors, strict=True):
            image = np.linalg.norm(position - place * [-1, 1, 1], axis=1).argmin()
            assert np.allclose(position[image], place * [-1, 1, 1], atol=1e-9)
            assert colors[image] == color
    assert (limits.led_counts == len(lamps)).all()


def test_a_lamp_without_an_image_stays_off(tmp_path: Path) -> None:
    path = mirrored_digit(tmp_path)
    path.write_text(path.read_text().replace("[7.4, -13.2", "[6.4, -13.2"))
    limits = limits_of(load_scene(path))
    assert limits.may_be_off
    # The row at the tip is its own image; the listed ones have none.
    assert limits.allowed[:, -1].tolist() == [False, True, True]
    assert limits.allowed[1:, :-1].any() == np.False_


def test_lamps_on_a_board_shine_up_and_do_not_turn(tmp_path: Path) -> None:
    board = (
        "[[search.places]]\ncorners = { value = [[-8.0, -8.0], [8.0, -8.0], [8.0, 8.0], "
        '[-8.0, 8.0]], unit = "mm", source = "test" }\nheights = { value = [-3.0], unit = "mm", '
        'source = "test" }\nlike = 0\npitch = { value = 4.0, unit = "mm", source = "test" }\n'
        "[[search.keep_out]]\n"
        'center = { value = [0.0, 0.0], unit = "mm", source = "test" }\n'
        'radius = { value = 3.0, unit = "mm", source = "the lens" }\n'
    )
    path = tmp_path / "mine.toml"
    path.write_text(scene_text("finger20").replace("schema = 1", "schema = 2") + board)
    scene = load_scene(path)
    assert all(scene.turning)
    searched = searched_scene(scene)
    assert searched.lamp_count == 20 + 16 - 4
    assert not any(searched.turning[20:])
    beams = [lamp.beam for lamp in searched.placed_lamps()[20:]]
    assert np.allclose(beams, [0.0, 0.0, 1.0], atol=1e-12)
