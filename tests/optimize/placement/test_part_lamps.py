"""Lamps that may be parts: one per place and body, one of them lit, within current and price."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from optimize.design import (
    DARK,
    Design,
    baseline_design,
    currents,
    dimmed_baseline,
    limits_of,
    one_led,
    part_entries,
    prices,
)
from optimize.mounting import mount, wiring_csv
from optimize.placement import built_scene, searched_scene
from optimize.placement.part_lamps import parts_drawn
from optimize.readers import CameraModel
from optimize.scoring import TableScorer, open_model, search_table
from optimize.search import ReaderObjective, search_by_reader
from render.errors import DesignError, SceneError
from render.scene import Scene, load_scene, scene_text

CHIPS = ("red-0603", "green-0603", "blue-0603")


def searched(tmp_path: Path, search: str, name: str = "digit") -> Scene:
    (tmp_path / "mine.toml").write_text(scene_text(name) + f"[search]\n{search}\n")
    return searched_scene(load_scene(tmp_path / "mine.toml"), place=False)


def lit(scene: Scene, colors: dict[int, str]) -> Design:
    chosen = np.full(scene.lamp_count, DARK)
    for lamp, name in colors.items():
        chosen[lamp] = scene.palette.index(name)
    drive = one_led(chosen, len(scene.palette.names)) * (chosen != DARK)[:, None]
    return Design(np.full(scene.lamp_count, np.pi / 2), drive, scene.palette)


def test_parts_of_one_body_share_a_lamp_and_others_have_their_own() -> None:
    scene = load_scene("digit")
    one = searched_scene(scene, place=False, parts=CHIPS)
    assert one.lamp_count == 3 + 3
    two = searched_scene(scene, place=False, parts=[*CHIPS, "ws2812b-2020"])
    assert two.lamp_count == 3 + 2 * 3
    allowed = limits_of(two).allowed
    names = np.array([*two.palette.names, "off"])
    assert [names[row].tolist() for row in allowed[:3]] == [["off"]] * 3
    assert names[allowed[3]].tolist() == [*CHIPS, "off"]
    assert names[allowed[4]].tolist() == [
        *(f"ws2812b-2020-{c}" for c in ("red", "green", "blue")),
        "off",
    ]


def test_of_lamps_on_one_place_one_is_lit() -> None:
    scene = searched_scene(load_scene("digit"), place=False, parts=["red-0603", "ws2812b-2020"])
    limits = limits_of(scene)
    both = lit(scene, {3: "red-0603", 4: "ws2812b-2020-red"}).colors
    apart = lit(scene, {3: "red-0603", 6: "ws2812b-2020-red"}).colors
    assert limits.fits(np.array([both, apart])).tolist() == [False, True]


def test_bodies_that_overlap_at_neighboring_places_exclude_each_other(tmp_path: Path) -> None:
    at = 'at = { value = [-2.0, 0.0, 4.0], unit = "mm", source = "x" }'
    text = f'[[search.places]]\nedge = "base"\n{at}\n'
    (tmp_path / "mine.toml").write_text(scene_text("digit") + text)
    scene = searched_scene(load_scene(tmp_path / "mine.toml"), parts=["ws2812b"])
    place = np.array([lamp.position for lamp in scene.placed_lamps()])
    gap = np.linalg.norm(place[:, None] - place[None], axis=2)
    exclusive = limits_of(scene).exclusive
    assert exclusive is not None
    new = slice(3, None)  # a WS2812B is 5 mm wide
    assert np.array_equal(
        exclusive[new, new], (gap < 5.0)[new, new] & ~np.eye(len(gap) - 3, dtype=bool)
    )
    assert exclusive[new, new].any()


def test_the_baseline_is_the_same_and_a_search_starts_from_parts_in_its_place() -> None:
    scene = load_scene("digit")
    parts = searched_scene(scene, place=False, parts=CHIPS)
    assert np.array_equal(baseline_design(parts).colors[:3], baseline_design(scene).colors)
    start = limits_of(parts).allowed_start(dimmed_baseline(parts))
    names = [parts.palette.name(color) for color in start.colors]
    assert names == ["off"] * 3 + ["blue-0603", "green-0603", "red-0603"]


def test_a_part_with_the_body_of_a_lamp_is_that_lamp(tmp_path: Path) -> None:
    text = scene_text("digit").replace("value = 1.3", "value = 1.277")
    (tmp_path / "mine.toml").write_text(text)
    scene = searched_scene(load_scene(tmp_path / "mine.toml"), place=False, parts=CHIPS)
    assert scene.lamp_count == 3


def test_current_and_price_are_budgets(tmp_path: Path) -> None:
    scene = searched(
        tmp_path,
        'parts = ["red-0603", "ws2812b-2020"]\nlamps = 3\n'
        'current = { value = 32.0, unit = "mA", source = "x" }\n'
        'price = { value = 0.21, unit = "USD", source = "x" }',
    )
    limits = limits_of(scene)
    assert [budget.key for budget in limits.budgets] == ["search.current", "search.price"]
    two = lit(scene, {3: "red-0603", 6: "ws2812b-2020-red"}).colors
    dear = lit(scene, {4: "ws2812b-2020-red", 6: "ws2812b-2020-red"}).colors
    strong = lit(scene, {3: "red-0603", 5: "red-0603"}).colors
    assert limits.fits(np.array([two, dear, strong])).tolist() == [True, False, False]


def test_a_current_holds_for_lamps_that_are_no_parts_too(tmp_path: Path) -> None:
    text = '[search]\ncurrent = { value = 45.0, unit = "mA", source = "x" }\n'
    (tmp_path / "mine.toml").write_text(scene_text("digit") + text)
    limits = limits_of(load_scene(tmp_path / "mine.toml"))
    every = np.array([[0, 1, 2], [0, 1, -1]])
    assert limits.fits(every).tolist() == [False, True]


@pytest.mark.parametrize(
    ("search", "said"),
    [
        (
            'parts = ["red-0603"]\ncurrent = { value = 5.0, unit = "mA", source = "x" }',
            r"search.current = 5 mA, but no lamp takes less than 20 mA, allowed: at least 20",
        ),
        (
            'parts = ["ws2812b-2020"]\nprice = { value = 0.1, unit = "USD", source = "x" }',
            r"search.price = 0.1 US dollars, but no lamp takes less than 0.15 US dollars",
        ),
    ],
)
def test_limits_that_forbid_every_lamp_are_told(tmp_path: Path, search: str, said: str) -> None:
    with pytest.raises(DesignError, match=said):
        limits_of(searched(tmp_path, search))


def test_a_part_without_a_price_has_none(tmp_path: Path) -> None:
    own = (
        '[[parts]]\nname = "mine"\nsource = "x"\nbody_mm = [1, 1]\nhalf_angle_deg = 60\n'
        "dies = [{ nm = 465, mcd = 100, ma = 20 }]\n"
    )
    price = 'price = { value = 1.0, unit = "USD", source = "x" }'
    scene = searched(tmp_path, f'parts = ["mine"]\n{price}\n{own}')
    with pytest.raises(DesignError, match=r"search.price: mine has no price, allowed: parts"):
        limits_of(scene)


@pytest.mark.parametrize(
    ("name", "parts", "said"),
    [
        ("digit", ["red-0604"], "parts = red-0604, allowed: .*did you mean red-0603"),
        ("digit", ["", ""], 'parts = "", allowed: red-0201'),
        (
            "gelsight-mini",
            ["ws2812b"],
            "parts = ws2812b fits on no place of gelsight-mini: it is 5 mm high, allowed: at most",
        ),
        ("finger20", ["red-0603"], "red-0603 fits on no place of finger20: a lamp at"),
    ],
)
def test_parts_that_do_not_fit_are_told(name: str, parts: list[str], said: str) -> None:
    with pytest.raises(SceneError, match=said) as caught:
        searched_scene(load_scene(name), place=False, parts=parts)
    assert caught.value.option == "--parts"


def test_a_design_of_parts_is_a_sensor_and_its_wiring_names_them() -> None:
    scene = searched_scene(load_scene("digit"), place=False, parts=[*CHIPS, "ws2812b-2020"])
    chosen = {3: "red-0603", 6: "ws2812b-2020-green", 7: "blue-0603"}
    design = lit(scene, chosen)
    mounting = mount(scene, design, step=0.0)
    assert {row.fiber: row.part for row in mounting.fibers if row.part} == {
        3: "red-0603",
        6: "ws2812b-2020",
        7: "blue-0603",
    }
    assert mounting.current == 20.0 + 12.0 + 20.0
    assert mounting.price == pytest.approx(0.06 + 0.15 + 0.08)
    assert "ws2812b-2020" in wiring_csv(mounting)
    assert parts_drawn(scene, design) == (
        "Parts: 1 red-0603, 1 blue-0603, 1 ws2812b-2020-green; 52 mA together, about 0.29 US "
        "dollars."
    )
    built = built_scene(scene, design, "mine")
    assert built.baseline_colors() == tuple(chosen.values())
    assert [lamp.diameter for lamp in built.placed_lamps()] == [1.277, 1.6, 1.277]
    limits = limits_of(built)
    assert limits.fits(baseline_design(built).colors[None])[0]
    again = searched_scene(built, place=False)
    assert again.lamp_count == 3 + 3
    assert np.array_equal(again.palette.matrix, scene.palette.matrix)


def test_what_a_part_draws_and_costs_is_known_by_color(tmp_path: Path) -> None:
    scene = searched(tmp_path, 'parts = ["apa102-2020"]')
    assert [entry is None for entry in part_entries(scene)] == [True] * 3 + [False] * 3
    assert currents(scene).tolist() == [20.0] * 3 + [10.0] * 3
    assert np.isnan(prices(scene)).tolist() == [True] * 3 + [False] * 3


def test_the_search_finds_the_best_of_all_choices_of_parts() -> None:
    drawn = load_scene("digit").with_(sites_columns=2, sites_rows=2)
    scene = searched_scene(drawn, place=False, parts=[*CHIPS, "ws2812b-2020"], lamps=3)
    table = search_table(open_model(scene, None, coarse=True))
    scorer = TableScorer(table, limits=limits_of(scene))
    goal = ReaderObjective(scorer, scene, "sensor", CameraModel.of(scene))
    start = scorer.limits.allowed_start(dimmed_baseline(scene))
    found = search_by_reader(scorer, goal, [start])
    options = [np.append(np.flatnonzero(row[:-1]), DARK) for row in scorer.limits.allowed]
    every = np.array(list(itertools.product(*options)))
    every = every[scorer.limits.fits(every) & (every != DARK).any(axis=1)]
    assert len(every) == 7**3 - 1
    values = goal.values([scorer.design(start.phi, colors) for colors in every])
    assert found.score == pytest.approx(values.max(), rel=1e-6)
    assert found.allowed == len(every)
    assert found.score > goal.value(start)
