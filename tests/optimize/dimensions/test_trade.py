"""Each sensor of a study has its own places, and limits that are varied make a map of the trade."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.design import Design, limits_of, open_rated
from optimize.design.runs import count_runs
from optimize.dimensions import (
    Study,
    Variants,
    begin_study,
    dimension_of,
    kept_answers,
    run_study,
    write_study,
)
from optimize.dimensions.answer import Answer, LightErrors, exposed_like
from optimize.dimensions.study_page import table_of
from optimize.exploration import explore
from optimize.placement import SearchSpace, built_scene, searched_scene
from render.errors import SceneError
from render.files import read_sealed
from render.scene import Scene, load_scene, scene_text
from surrogate.preview_model import preview_checker

SIDES = """
[search]
[[search.places]]
edge = "left"
at = { value = [-6.0, 6.0], unit = "mm", source = "test" }
[[search.places]]
edge = "right"
at = { value = [-6.0, 6.0], unit = "mm", source = "test" }
"""


@pytest.fixture(scope="module")
def sides(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Return a DIGIT of four sites with four places beside its three lamps."""
    path = tmp_path_factory.mktemp("scene") / "sides.toml"
    path.write_text(scene_text("digit") + SIDES)
    return load_scene(path).with_(sites={"columns": 2, "rows": 2}, indenter={"faces": 6})


def study_of(scene: Scene, *texts: str, **options: Any) -> Study:
    variants = Variants(
        scene, [dimension_of(scene, text) for text in texts], space=SearchSpace(**options)
    )
    return run_study(variants, coarse=True)


@pytest.fixture(scope="module")
def trade(sides: Scene) -> Study:
    """Return what one to five lit lamps are worth."""
    return study_of(sides, "search.lamps=1:5:1")


def test_each_sensor_is_answered_with_its_own_best_places(sides: Scene) -> None:
    found = study_of(sides, "pad.thickness=5")
    own = preview_checker(searched_scene(sides), coarse=True).exposure
    for row in found.rows:
        (thickness,) = row.values
        scene = searched_scene(sides if thickness == 6.15 else sides.with_(pad_thickness=thickness))
        checker = preview_checker(scene, coarse=True)
        if thickness != 6.15:
            scene = exposed_like(scene, checker.exposure, own)
        by_hand = explore(scene, checker, objective="sensor")
        assert by_hand.design.phi.shape == (7,)
        assert row.answer.proven == by_hand.proven
        assert np.array_equal(row.answer.design.drive, by_hand.design.drive)
        assert np.array_equal(row.answer.best.sensor, by_hand.stages[-1].reading.sensor.means)
        assert found.scene_of(row).hash == scene.hash
    assert found.pareto == frozenset()


def test_limits_are_one_sensor_whose_light_is_followed_once(sides: Scene, trade: Study) -> None:
    assert trade.variants.one_sensor
    assert {trade.scene_of(row).hash for row in trade.rows} == {searched_scene(sides).hash}
    assert not trade.finalists
    assert not study_of(sides, "pad.thickness=5", "search.lamps=3").variants.one_sensor


def test_more_lamps_never_read_worse_and_no_more_are_lit(trade: Study) -> None:
    errors = [row.answer.best.mean("sensor") for row in trade.rows]
    assert errors == sorted(errors, reverse=True)
    for row in trade.rows:
        lit = int((row.answer.design.colors >= 0).sum())
        assert 1 <= lit <= row.values[0]
    assert trade.rows[2].values == trade.variants.present
    assert "lamps instead of 3 lamps" in trade.sentence
    assert not trade.warnings()


def test_what_a_search_missed_is_what_less_allows(
    sides: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every answer is invented: with five lamps the search is out of luck."""
    invented = {1: 9.0, 2: 2.0, 3: 3.0, 4: 1.0, 5: 8.0}

    def answer(scene: Scene, effort: Any, *_: Any) -> Answer:
        assert scene.search is not None
        most = scene.search.lamps
        assert most is not None
        draws = np.full(8, invented[most])
        errors = LightErrors(draws, draws, {}, 1.0, 0.0)
        limits = limits_of(scene)
        preference = np.random.default_rng(most).uniform(size=limits.allowed.shape)
        colors = limits.nearest_colors(preference)
        drive = np.where(colors[:, None] == np.arange(3), 1.0, 0.0)
        design = Design(np.full(len(colors), np.pi / 2), drive, scene.palette)
        return Answer(effort, errors, errors, design, None, 1.0, None, 0.0)

    monkeypatch.setattr(kept_answers, "answer", answer)
    found = study_of(sides, "search.lamps=1:5:1")
    assert [row.answer.best.mean("sensor") for row in found.rows] == [9.0, 2.0, 2.0, 1.0, 1.0]
    assert found.pareto == {(1.0,), (2.0,), (4.0,)}
    # The sensor as it is has what is best for it as well: 1 instead of 2.
    assert found.rows[3].changes["sensor"].value == pytest.approx(-0.5)


def beaten(rows: Sequence[tuple[tuple[float, ...], float]], number: int) -> bool:
    """Return whether another row is no worse anywhere and better somewhere: by definition."""
    costs, error = rows[number]
    for other, less in rows:
        pairs = [*zip(other, costs, strict=True), (less, error)]
        if all(a <= b for a, b in pairs) and any(a < b for a, b in pairs):
            return True
    return False


def test_pareto_rows_of_two_limits_are_those_of_the_definition(trade: Study, sides: Scene) -> None:
    variants = Variants(
        sides, [dimension_of(sides, text) for text in ("search.lamps=1:4:1", "search.runs=1:3:1")]
    )
    rng, row = np.random.default_rng(3), trade.rows[0]
    for _ in range(20):
        rows = []
        for values in itertools.product((1.0, 2.0, 3.0, 4.0), (1.0, 2.0, 3.0)):
            draws = np.full(8, float(rng.integers(1, 7)))
            best = LightErrors(draws, draws, {}, 1.0, 0.0)
            rows.append(replace(row, values=values, answer=replace(row.answer, best=best)))
        found = replace(trade, variants=variants, rows=tuple(rows))
        points = [(one.values, one.answer.best.mean("sensor")) for one in rows]
        expected = {one.values for n, one in enumerate(rows) if not beaten(points, n)}
        assert found.pareto == expected


def test_every_point_of_a_map_is_a_design_that_becomes_a_sensor(
    trade: Study, tmp_path: Path
) -> None:
    target = tmp_path / "trade"
    begin_study(target, {"scene": "sides"})
    result = write_study(target, trade)
    headings, rows = table_of(trade)
    assert headings[-1] == "Pareto"
    assert [bool(cells[-1]) for cells in rows] == [one["pareto"] for one in result["rows"]]
    assert read_sealed(target / "result.json") == result
    for row, said in zip(trade.rows, result["rows"], strict=True):
        assert said["proven_best_of"] == row.answer.proven
        rated = open_rated(Path(said["design"]))
        assert Path(said["design"]) == target / "points" / f"{row.values[0]:g}" / "design.json"
        sensor = built_scene(rated.scene, rated.design, "mine")
        assert sensor.lamp_count == int((row.answer.design.colors >= 0).sum())
        assert rated.rating.read is not None
        assert rated.rating.read.reader_error_deg == pytest.approx(
            row.answer.best.measured("sensor")
        )


def test_runs_of_a_sensor_whose_lamps_stay_are_a_map_as_well(small: Scene, tmp_path: Path) -> None:
    found = study_of(small, "search.runs=1,2,3")
    result = write_study(tmp_path / "runs", found)
    for row, said in zip(found.rows, result["rows"], strict=True):
        rated = open_rated(Path(said["design"]))
        assert count_runs(rated.design.colors[None])[0] <= row.values[0]
        assert limits_of(rated.scene).fits(rated.design.colors[None])[0]
    errors = [row.answer.best.mean("sensor") for row in found.rows]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 2.0 * errors[2]


@pytest.mark.parametrize(
    ("name", "text", "options", "told"),
    [
        ("digit", "search.lamps=2", {"lamps": 4}, "search.lamps is varied and lamps = 4 as well"),
        ("digit", "search.lamps=0,2", {}, "search.lamps = 0 makes no valid sensor"),
        ("digit", "search.lamps=2.5", {}, "allowed: whole numbers"),
        ("digit", "pad.thickness=5", {"lamps": 99, "place": True}, "lamps = 99, allowed: 1 to 34"),
        ("apart", "search.apart=2,3", {}, "search.apart changes nothing while no lamp may sit"),
        ("digit", "search.apart=2,3", {}, "is no number that the file of digit says"),
    ],
)
def test_limits_that_cannot_be_are_one_sentence(
    name: str, text: str, options: dict[str, Any], told: str, tmp_path: Path
) -> None:
    if name == "apart":
        apart = '[search]\napart = { value = 1.0, unit = "mm", source = "test" }\n'
        (tmp_path / "apart.toml").write_text(scene_text("digit") + "\n" + apart)
        name = str(tmp_path / "apart.toml")
    scene = load_scene(name)
    with pytest.raises(SceneError) as refused:
        Variants(scene, [dimension_of(scene, text)], space=SearchSpace(**options))
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_parts_and_shots_are_chosen_on_every_sensor(sides: Scene) -> None:
    space = SearchSpace(parts=("red-0603", "green-0603"), shots=2)
    variants = Variants(sides, [dimension_of(sides, "coating.albedo=0.4,0.5")], space=space)
    for values in variants:
        palette = variants.at(values).palette
        assert palette.shots == 2
        assert {"red-0603", "green-0603"} < set(palette.one_shot.names)
    with pytest.raises(SceneError, match=r"camera\.shots is varied and shots = 2 as well"):
        Variants(sides, [dimension_of(sides, "camera.shots=1,2")], space=space)
