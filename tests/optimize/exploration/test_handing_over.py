"""A design that reads worse than the baseline is never handed over."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.design import Design, dimmed_baseline
from optimize.exploration import Exploration, exploration, explore, rate
from optimize.objectives import ObjectiveName
from optimize.placement import moved_sentence, searched_scene
from optimize.readers import compare_readings, reads_better
from optimize.report import warnings
from optimize.scoring import open_model, trained_model
from optimize.search import ReaderOptimum
from render.scene import load_scene
from surrogate.runtime import RankingTest


def explored(objective: ObjectiveName) -> Exploration:
    scene = load_scene("digit")
    checker = trained_model(scene)
    assert checker is not None
    return explore(scene, checker, objective=objective)


@pytest.mark.parametrize("objective", ["sensor", "place"])
def test_what_a_search_finds_reads_no_worse_than_the_baseline(
    objective: ObjectiveName,
) -> None:
    found = explored(objective)
    base, last = found.stages[0], found.stages[-1]
    pair = {"sensor": (base.reader_error, last.reader_error),
            "place": (base.normal_error, last.normal_error)}  # fmt: skip
    before, after = pair[objective]
    assert after <= before
    assert last.rating.read is not None
    assert last.rating.read.reader_error_deg == pytest.approx(last.reader_error)


def test_the_baseline_is_handed_over_where_a_search_goes_astray(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    base = dimmed_baseline(load_scene("digit"))
    # What the closed forms like and the readers do not: one color for everything.
    astray = Design.of_colors(base.phi, np.zeros(len(base.phi), dtype=int), base.palette)
    found = ReaderOptimum(astray, 0.0)
    monkeypatch.setattr(exploration, "search_by_reader", lambda *_, **__: found)
    found = explored("sensor")
    assert np.array_equal(found.design.drive, base.drive)
    assert found.readings["regressor_mean"].interval[0] > 0.0
    said = warnings(found.stages, found.ranking, found.objective)
    assert any("the baseline is handed over" in text for text in said)


def test_fewer_lamps_are_handed_over_although_the_baseline_has_more() -> None:
    scene = searched_scene(load_scene("digit"), place=False, lamps=2)
    checker = trained_model(scene)
    assert checker is not None
    found = explore(scene, checker)
    assert int((found.design.colors >= 0).sum()) == 2
    assert found.proven == 3 + 3 * 2  # one of 3, or two, alike or not in color
    assert found.stages[-1].reader_error > found.stages[0].reader_error


def test_the_same_leds_read_better_at_other_places() -> None:
    scene = searched_scene(load_scene("digit").with_(sites_columns=2, sites_rows=2))
    found = explore(scene, open_model(scene, None, coarse=True))
    base, last = found.stages[0], found.stages[-1]
    assert last.reader_error < 0.75 * base.reader_error
    assert sorted(color for color in found.design.colors if color >= 0) == [0, 1, 2]
    said = moved_sentence(found)
    assert " at new places: sensor reader " in said
    assert said.endswith(
        f"The best of all {found.proven:,} designs with at most 3 of 34 lamps lit, compared by the "
        "expected error of the sensor reader."
    )


def test_a_class_that_is_too_large_is_said_to_be_not_proven() -> None:
    scene = searched_scene(load_scene("digit").with_(sites_columns=2, sites_rows=2), lamps=5)
    found = explore(scene, open_model(scene, None, coarse=True), objective="score")
    assert found.proven is None
    assert found.proof == (
        "Not proven to be the best of all designs with at most 5 of 34 lamps lit: swaps climbed "
        "from many starts."
    )


def test_what_a_model_may_be_off_by_is_said_and_hands_nothing_back() -> None:
    scene = searched_scene(load_scene("digit").with_(sites_columns=2, sites_rows=2))
    checker = open_model(scene, None, coarse=True)
    base, found = (
        rate(checker, scene, key, key, "", design)
        for key, design in (
            ("baseline", dimmed_baseline(scene)),
            ("optimized", Design.of_colors(np.full(34, np.pi / 2), few_places())),
        )
    )
    gain = compare_readings(base.reading, found.reading)["regressor_mean"]
    assert gain.difference < 0.0
    assert reads_better(base.reading, found.reading, "sensor")
    assert not reads_better(found.reading, base.reading, "sensor")
    said = warnings((base, found), RankingTest.of(checker.metadata), "sensor")
    doubted = any("may be off by more than the sensor reader gains" in text for text in said)
    assert doubted == (gain.interval[1] >= 0.0)


def few_places() -> np.ndarray:
    """Return colors of DIGIT's LEDs among its places: two on the right, one at the base."""
    colors = np.full(34, -1)
    colors[[22, 25, 32]] = 0, 1, 2
    return colors


def test_a_design_that_is_known_is_gone_on_from() -> None:
    scene = load_scene("gelsight-mini")
    checker = trained_model(scene)
    assert checker is not None
    known = explore(scene, checker, seed=1).design
    again = explore(scene, checker, seed=2, starts=[known])
    rated = rate(checker, scene, "known", "Known", "", known)
    assert again.stages[-1].reader_error <= rated.reader_error * 1.01
