"""Studies on the preview: the same as by hand, kept answers bit by bit, the best as a file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import tactilux
from optimize.dimensions import (
    RelativeChange,
    Study,
    Variants,
    dimension_of,
    kept_answers,
    run_study,
)
from optimize.dimensions import study as study_module
from optimize.dimensions.answer import Answer, answer, exposed_like
from optimize.dimensions.study import first_effort
from optimize.exploration import explore
from optimize.readers import CameraModel
from render.preview.converged import Effort, cache
from render.scene import Scene, load_scene, sources
from surrogate.preview_model import preview_checker


def errors_of(study: Study) -> list[list[float]]:
    return [
        [*row.values, *row.answer.baseline.sensor, *row.answer.best.sensor, *row.answer.best.place]
        for row in study.rows
    ]


def test_a_grid_is_what_exploring_every_value_by_hand_gives(distances: Study, small: Scene) -> None:
    assert [row.values for row in distances.rows] == [(14.9,), (15.0,), (15.1,)]
    own = preview_checker(small, coarse=True).exposure
    for row in distances.rows:
        (distance,) = row.values
        scene = small if distance == 15.0 else small.with_(camera_distance=distance)
        checker = preview_checker(scene, coarse=True)
        if distance != 15.0:
            longest = CameraModel.of(small).longest_exposure * own / checker.exposure
            scene = scene.with_(camera_longest_exposure=longest)
        found = explore(scene, checker, objective="sensor")
        assert np.array_equal(row.answer.best.sensor, found.stages[-1].reading.sensor.means)
        assert np.array_equal(row.answer.best.place, found.stages[-1].reading.place.means)
        assert np.array_equal(row.answer.baseline.place, found.stages[0].reading.place.means)
        assert np.array_equal(row.answer.design.drive, found.design.drive)


def test_a_dimension_that_hardly_matters_has_intervals_that_hold_0(distances: Study) -> None:
    for row in distances.rows:
        for change in row.changes.values():
            assert change.interval[0] < 0.0 < change.interval[1]
            assert abs(change.value) < 0.05
    assert not distances.chosen.changes
    assert distances.best.scene is distances.scene
    assert distances.sentence.startswith("No other sensor is certain to be better; the best of")


def test_a_darker_sensor_is_granted_no_longer_exposure(small: Scene) -> None:
    black = small.with_(coating_albedo=0.05)
    exposures = [preview_checker(one, coarse=True).exposure for one in (small, black)]
    limited = exposed_like(black, exposures[1], exposures[0])
    assert limited.hash == black.hash
    longest = [CameraModel.of(one).longest_exposure for one in (small, limited)]
    assert longest[1] * exposures[1] == pytest.approx(longest[0] * exposures[0])
    free, held = (answer(black, "drawn", "sensor", 0, to) for to in (exposures[1], exposures[0]))
    assert held.best.exposure < free.best.exposure
    assert held.best.mean("sensor") > free.best.mean("sensor")


def test_an_answer_is_read_back_bit_by_bit(distances: Study, small: Scene) -> None:
    said = distances.rows[0].answer
    assert (
        said.to_json() == Answer.from_json(json.loads(json.dumps(said.to_json())), small).to_json()
    )


def test_a_stopped_study_goes_on_and_asks_again_what_was_cut_off(
    small: Scene, distances: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    variants = Variants(small, [dimension_of(small, "camera.distance=14.9,15.1")])
    asked: list[Scene] = []

    def stopping(scene: Scene, *more: Any) -> Answer:
        if len(asked) == stop:
            raise KeyboardInterrupt
        asked.append(scene)
        return answer(scene, *more)

    monkeypatch.setattr(kept_answers, "answer", stopping)
    stop = 2
    with pytest.raises(KeyboardInterrupt):
        run_study(variants, coarse=True, folder=tmp_path)
    kept = sorted(tmp_path.glob("*.json"))
    assert len(kept) == 2
    kept[0].write_text(kept[0].read_text()[:100])
    asked, stop = [], 9
    again = run_study(variants, coarse=True, folder=tmp_path)
    assert len(asked) == 2
    assert errors_of(again) == errors_of(distances)
    asked = []
    # Another range takes over what it shares with the first.
    wider = Variants(small, [dimension_of(small, "camera.distance=14.9,15.1,15.2")])
    run_study(wider, coarse=True, folder=tmp_path)
    assert len(asked) == 1


def certain(study: Study) -> Study:
    """Return the study as it were if the first other sensor were certain to be better."""
    row = next(row for row in study.rows if row.changes)
    sure = RelativeChange(-0.12, (-0.15, -0.09))
    better = replace(row, changes=dict.fromkeys(row.changes, sure))
    return replace(study, rows=tuple(better if one is row else one for one in study.rows))


def test_the_best_sensor_is_a_scene_that_says_where_it_is_from(distances: Study) -> None:
    found = certain(distances)
    assert found.sentence == "14.9 mm instead of 15 mm: sensor reader 12 % [9, 15] lower."
    best = found.best
    assert (best.scene.name, best.scene.camera.distance) == ("digit-best", 14.9)
    told = sources(best.scene)["camera.distance"]
    assert told.startswith("chosen by tactilux explore digit --vary camera.distance=14.9,15.1: ")
    assert "12 % [9, 15] lower" in told
    assert best.design.check_fits(best.scene) is None
    assert CameraModel.of(best.scene).longest_exposure == pytest.approx(4.0, rel=0.1)
    assert best.reader_error == pytest.approx(found.leading.answer.best.measured("sensor"))


def test_the_best_is_certain_to_be_better_even_where_another_may_be_better_still(
    distances: Study,
) -> None:
    first, present, last = distances.rows
    unsure, sure = RelativeChange(-0.2, (-0.5, 0.1)), RelativeChange(-0.1, (-0.15, -0.05))
    rows = tuple(
        replace(row, changes=dict.fromkeys(row.changes, change))
        for row, change in ((first, unsure), (present, sure), (last, sure))
    )
    assert replace(distances, rows=rows).chosen.values == last.values


def test_sensors_that_are_certain_to_be_worse_are_named(distances: Study) -> None:
    assert distances.worse == ""
    higher = RelativeChange(0.2, (0.1, 0.3))
    rows = tuple(replace(row, changes=dict.fromkeys(row.changes, higher)) for row in distances.rows)
    found = replace(distances, rows=rows)
    assert found.worse == "Certain to be worse: 14.9 mm; 15.1 mm."
    # What a finer effort says of a sensor counts.
    finer = replace(found, finalists=(distances.rows[1], distances.rows[2]))
    assert finer.worse == "Certain to be worse: 14.9 mm."


def test_the_end_of_a_range_is_said(small: Scene, distances: Study) -> None:
    assert distances.warnings() == []
    variants = Variants(small, [dimension_of(small, "camera.distance=14.9,15,15.1")])
    (told,) = certain(replace(distances, variants=variants)).warnings()
    assert told.startswith("camera.distance = 14.9 mm is at the end of its range")


def test_several_dimensions_are_a_grid_where_combinations_are_few(small: Scene) -> None:
    found = tactilux.study(
        small, {"camera.distance": [14.9, 15.0], "rows.gap": "0.7:0.8:0.1"}, coarse=True
    )
    assert len(found.rows) == 4
    assert "camera.distance 1" in found.sentence
    assert found.to_json()["sensors"] == 4
    figure = found.plot()
    assert isinstance(figure, Figure)
    assert [axes.get_xlabel() for axes in figure.axes] == ["camera.distance, mm", "rows.gap, mm"]
    shown = found._repr_html_()
    assert shown.count("<tr>") == 5
    assert repr(found).startswith("<Study of digit: ")


@pytest.mark.slow
def test_a_search_of_two_dimensions_finds_the_best_of_its_grid(
    small: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    texts = "pad.thickness=4:6:0.5", "coating.albedo=0.2:0.8:0.2"
    variants = Variants(small, [dimension_of(small, text) for text in texts])
    grid = run_study(variants, coarse=True, folder=tmp_path)
    assert len(grid.rows) == 21
    monkeypatch.setattr(study_module, "PER_DIMENSION", 7)
    found = run_study(variants, coarse=True, folder=tmp_path)
    assert len(found.rows) <= 15
    assert found.leading.values == grid.leading.values


@pytest.fixture
def faint(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Let traced light be of few photons, which are kept nowhere else."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for effort, photons in (("FEW_PATHS", 2_000), ("EFFORT", 8_000)):
        paths = Effort(photons=photons, paths=512, arrivals=100 * photons, rounds=1)
        monkeypatch.setattr(cache, effort, paths)


def test_finalists_are_answered_by_converged_light_without_its_noise(
    small: Scene, faint: None
) -> None:
    scene = small.with_(sites={"rows": 1})
    found = tactilux.study(scene, {"camera.distance": [14.9]})
    assert [row.answer.effort for row in found.rows] == ["few"] * 2
    assert [row.answer.effort for row in found.finalists] == ["converged"] * 2
    assert found.finalists[0].values == (15.0,)
    assert found.judged is found.finalists
    for row in found.finalists:
        best = row.answer.best
        assert best.noisier["sensor"].shape == best.sensor.shape
        assert best.mean("sensor") <= best.measured("sensor")
    for row in found.finalists[1:]:
        low, high = row.changes["sensor"].interval
        assert low < 0.0 < high


def test_behind_a_diffuser_and_where_asked_the_preview_answers_first() -> None:
    finger, digit = (
        Variants(scene, [dimension_of(scene, "pad.thickness=5")])
        for scene in map(load_scene, ("finger20", "digit"))
    )
    assert first_effort(finger, coarse=False) == "drawn"
    assert first_effort(digit, coarse=False) == "few"
    assert first_effort(digit, coarse=True) == "drawn"
