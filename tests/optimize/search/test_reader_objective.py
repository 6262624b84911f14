"""A search for degrees: exact slopes, and against brute force where the class is small."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from optimize.design import DARK, Design, dimmed_baseline, limits_of
from optimize.objectives import READERS, ReaderName
from optimize.placement import searched_scene
from optimize.readers import CameraModel
from optimize.scoring import TableScorer, open_model, search_table, trained_model
from optimize.search import ReaderObjective, reader_objective, refine_by, search_by_reader
from render.errors import TableError
from render.scene import Scene, load_scene, unchecked
from surrogate.runtime import Checker
from tests.optimize.slopes import assert_slopes_are_differences


def objective(
    scene: Scene, checker: Checker, reader: ReaderName, camera: CameraModel | None = None
) -> tuple[TableScorer, ReaderObjective]:
    scorer = TableScorer(search_table(checker), limits=limits_of(scene))
    return scorer, ReaderObjective(scorer, scene, reader, camera or CameraModel())


@pytest.mark.parametrize("longest", [4.0, 0.5])
@pytest.mark.parametrize("reader", READERS)
def test_slopes_are_those_of_differences_at_the_designs_own_exposure(
    reader: ReaderName, longest: float, finger20: Scene, finger20_checker: Checker
) -> None:
    _, goal = objective(finger20, finger20_checker, reader, CameraModel(longest_exposure=longest))
    rng, base = np.random.default_rng(5), dimmed_baseline(finger20)
    design = Design(base.phi + rng.normal(0, 0.1, 20), 0.7 * base.drive, base.palette)
    assert_slopes_are_differences(goal, design, rng)


@pytest.mark.parametrize("reader", READERS)
def test_colors_of_few_lamps_are_those_of_brute_force(reader: ReaderName) -> None:
    scene = load_scene("digit")
    checker = trained_model(scene)
    assert checker is not None
    scorer, goal = objective(scene, checker, reader)
    base = dimmed_baseline(scene)
    choices = range(len(scene.palette.names))
    every = [
        scorer.design(base.phi, np.array(colors))
        for colors in itertools.product(choices, repeat=scene.lamp_count)
        if scorer.limits.fits(np.array([colors]))[0]
    ]
    best = goal.values(every).max()
    found = search_by_reader(scorer, goal, [every[0]], seed=3)
    assert found.score == pytest.approx(best, rel=1e-6)
    assert goal.value(found.design) == pytest.approx(found.score)
    if scorer.colors_alike:
        kept = [
            (np.array(names)[found.design.colors] == every[0].colors).sum()
            for names in itertools.permutations(choices)
        ]
        assert kept[0] == max(kept)


@pytest.mark.parametrize("reader", READERS)
def test_places_are_those_of_brute_force_and_a_search_finds_them_too(
    reader: ReaderName, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = searched_scene(load_scene("digit").with_(sites_columns=2, sites_rows=2))
    scene = unchecked(scene, {"lamps": scene.lamps[:16]})  # of the left edge, and two of the tip
    baseline = unchecked(scene.baseline, {"lamps": scene.baseline.lamps[:16]})
    scene = unchecked(scene, {"baseline": baseline})
    scorer, goal = objective(scene, open_model(scene, None, coarse=True), reader)
    base = dimmed_baseline(scene)
    every = [
        [places.index(lamp) if lamp in places else DARK for lamp in range(scene.lamp_count)]
        for places in itertools.permutations(range(scene.lamp_count), 3)
    ]
    best = goal.values([scorer.design(base.phi, np.array(colors)) for colors in every]).max()
    found = search_by_reader(scorer, goal, [base])
    assert found.proven
    assert found.score == pytest.approx(best, rel=1e-6)
    monkeypatch.setattr(reader_objective, "MOST_PROVEN", 0)
    searched = search_by_reader(scorer, goal, [base])
    assert not searched.proven
    assert searched.score >= best * 1.01  # minus degrees


def test_directions_in_steps_are_refined_to_steps(
    finger20: Scene, finger20_checker: Checker
) -> None:
    scorer, goal = objective(finger20, finger20_checker, "sensor")
    step = np.radians(5.0)
    scorer.limits = replace(scorer.limits, step=step)
    base = dimmed_baseline(finger20)
    found = refine_by(scorer, goal, base)
    assert found.score > goal.value(base)
    assert found.design.phi / step == pytest.approx(np.round(found.design.phi / step))


def test_a_table_without_the_untouched_pad_is_refused(
    finger20: Scene, finger20_checker: Checker
) -> None:
    table = replace(search_table(finger20_checker), background=None, background_se=None)
    with pytest.raises(TableError, match="has no background"):
        ReaderObjective(TableScorer(table), finger20, "sensor", CameraModel())
