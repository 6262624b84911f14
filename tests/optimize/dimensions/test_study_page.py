"""The folder of a study: a scene and designs that every command takes, a page that opens."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from optimize.design import find_scene, load_design_file, open_rated
from optimize.dimensions import Study, begin_study, print_study_table, write_study
from optimize.dimensions.study_page import BEST, DESIGN, PAGE, PLOT, PRESENT_DESIGN, rows_of
from optimize.records import find_runs
from render.files import read_sealed
from render.scene import load_scene
from tests.optimize.browser import SCREENS, look, pale_text
from tests.optimize.dimensions.test_study import certain

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="module")
def written(distances: Study, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """Write a study whose first sensor is certain to be better."""
    target = tmp_path_factory.mktemp("runs") / "study"
    begin_study(target, {"scene": "digit"})
    return target, write_study(target, certain(distances))


def test_the_best_sensor_is_a_file_and_its_design_finds_it(
    written: tuple[Path, Any], distances: Study
) -> None:
    target, result = written
    best = load_scene(target / BEST)
    assert best.camera.distance == 14.9
    assert result == read_sealed(target / "result.json")
    assert result["sentence"] == "14.9 mm instead of 15 mm: sensor reader 12 % [9, 15] lower."
    for name, scene in ((DESIGN, best), (PRESENT_DESIGN, distances.scene)):
        saved = load_design_file(target / name)
        assert saved.scene_hash == scene.hash
        found = find_scene(saved.scene, target / name, saved.scene_hash)
        assert found is not None
        assert load_scene(found).hash == scene.hash
        assert open_rated(target / name).rating.read is not None
    assert (target / PLOT).read_bytes()[:4] == b"\x89PNG"
    assert find_scene("digit-best", target / DESIGN, best.hash) == str(target / BEST)


def test_it_is_listed_among_the_runs_with_its_sentence(
    written: tuple[Path, Any], distances: Study
) -> None:
    target, result = written
    (run,) = find_runs(target.parent)
    assert (run.kind, run.state, run.path) == ("study", "finished", target)
    assert (run.scene, run.scene_hash) == (distances.scene.name, distances.scene.hash)
    assert run.note == result["sentence"]
    assert run.design == target / DESIGN
    assert run.report == target / PAGE


def test_a_short_table_leaves_out_what_is_worst_and_never_the_sensor_as_it_is(
    distances: Study,
) -> None:
    assert rows_of(distances) == list(distances.rows)
    best = min(distances.rows, key=lambda row: row.answer.best.mean("sensor"))
    kept = rows_of(distances, 1)
    assert {row.values for row in kept} == {best.values, (15.0,)}
    stream = io.StringIO()
    print_study_table(stream, distances)
    assert "on the page" not in stream.getvalue()
    assert distances.sentence in stream.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("screen", SCREENS)
def test_the_page_opens_without_a_network_and_nothing_sticks_out(
    written: tuple[Path, Any], chromium: Browser, screen: str
) -> None:
    seen = look(chromium, written[0] / PAGE, screen)
    assert seen.requests == seen.complaints == seen.wide == seen.blank == seen.small == []
    assert seen.page <= 0
    assert seen.pictures == 2


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_its_words_are_easy_to_read(
    written: tuple[Path, Any], chromium: Browser, scheme: str
) -> None:
    pale, _ = pale_text(chromium, written[0] / PAGE, scheme)
    assert pale == []
