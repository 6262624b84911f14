"""Finalists: what renders say of them, and for how long they are rendered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from optimize.design import Design, ScoreSettings, baseline_design
from optimize.objectives import READERS, ReaderName
from optimize.verification.finalists import FinalistEvaluation, evaluate_finalists
from optimize.verification.judges import judge_of
from render.scene import Scene, load_scene
from render.transport import TransportTable
from tests.optimize.conftest import MakeTable
from tests.optimize.verification.pretended_renders import BASE, biased, pretended


def test_the_evaluation_of_finalists_tells_a_gain_from_a_tie(
    small: Scene, table: TransportTable
) -> None:
    base, settings = baseline_design(small), ScoreSettings(table.exposure, table.lam)
    judge = judge_of("score", small, settings)
    dim = Design(base.phi, 0.5 * base.power)
    same = Design(base.phi + 1e-4, base.power)
    found = evaluate_finalists(
        pretended(table, 0.02), judge, [("baseline", base), ("dim", dim), ("same", same)],
        samples=3, seeds=[1, 2],
    )  # fmt: skip
    assert found.comparison("dim", "baseline").startswith(
        "The baseline is better in S than the dim"
    )
    assert "tie" in found.comparison("baseline", "same")
    plural = replace(found, names=("baseline", "colors", *found.names[2:]))
    said = {plural.comparison("baseline", "colors"), plural.comparison("colors", "baseline")}
    assert all(text.startswith("The baseline is better in S than the colors") for text in said)
    worse = replace(plural, names=("colors", "baseline", *found.names[2:]))
    assert worse.comparison("colors", "baseline").startswith(
        "The colors are better in S than the baseline"
    )
    exact = settings.parts(table.at(base.phi) * biased(base.phi, BASE)[:, None, None, None],
                        base.power)[0]  # fmt: skip
    score = found.score("baseline").score
    assert score.value == pytest.approx(exact, abs=4 * score.se)


def test_finalists_that_have_not_converged_neither_lead_nor_settle_the_verdict(
    make_table: MakeTable,
) -> None:
    clear = verdict(make_table, 0.1, 0.8, 1)
    assert clear.best("runner-up") == "winner"
    assert clear.settled("runner-up", 0.5)
    error = clear.renders.error.copy()
    index = clear.names.index("winner")
    error[index] = clear.renders.replicates[:, index].mean(axis=0)
    doubtful = replace(clear, renders=replace(clear.renders, error=error))
    assert doubtful.best("runner-up") == "runner-up"
    assert not doubtful.settled("runner-up", 0.5)
    assert "have not converged" in doubtful.comparison("runner-up", "winner")


BUDGET = 5.0


def verdict(make_table: MakeTable, noise: float, power: float, seed: int) -> FinalistEvaluation:
    """Return that on a design and its equal at less power, one second a batch."""
    table = make_table()
    table = replace(table, bends=np.arange(2.0), background=table.T[..., 0])
    base = Design.of_colors(np.full(8, np.pi / 2), np.arange(8) * 3 // 8)
    return evaluate_finalists(
        pretended(table, noise, strength=0.0, seconds=1.0),
        judge_of("score", load_scene("finger20"), ScoreSettings(table.exposure, table.lam)),
        [("winner", base), ("runner-up", Design(base.phi, power * base.power))],
        samples=1, seeds=[100 * seed], leader="winner", seconds=BUDGET,
    )  # fmt: skip


@pytest.mark.slow
def test_looking_again_keeps_to_the_error_rate_and_to_the_budget(make_table: MakeTable) -> None:
    found = [verdict(make_table, 0.1, 1.0, seed) for seed in range(24)]
    decided = [low > 0.0 or high < 0.0 for low, high in (
        entry.interval("winner", "runner-up") for entry in found)]  # fmt: skip
    assert sum(decided) <= 4  # of 24 ties; more than 4 have a chance of 1 in 160 at 5 %
    assert max(entry.renders.seconds for entry in found) <= BUDGET
    # Some ties cannot be decided any more long before the time is used.
    assert min(entry.renders.seconds for entry in found) < BUDGET
    assert all(entry.confidence >= 0.95 for entry in found)


def test_finalists_are_rendered_until_the_verdict_is_significant(make_table: MakeTable) -> None:
    clear, close = verdict(make_table, 0.1, 0.8, 1), verdict(make_table, 0.3, 0.9, 3)
    assert clear.renders.seconds == 1.0
    assert 1.0 < close.renders.seconds <= BUDGET
    for found in (clear, close):
        assert found.best("runner-up") == found.best("winner") == "winner"
        assert found.interval("runner-up", "winner")[0] > 0.0
    assert len(close.renders.replicates) == 8 * close.renders.seconds


@pytest.mark.parametrize("reader", READERS)
def test_a_reader_decides_between_finalists_and_their_files_say_what_it_misses(
    small: Scene, table: TransportTable, reader: ReaderName
) -> None:
    base, settings = baseline_design(small), ScoreSettings(table.exposure, table.lam)
    gray = Design(base.phi, np.full_like(base.power, 0.5))
    found = evaluate_finalists(
        pretended(table, 0.02), judge_of(reader, small, settings),
        [("baseline", base), ("gray", gray)], samples=3, seeds=[1, 2], leader="gray",
    )  # fmt: skip
    assert found.best("gray") == "baseline"
    said = found.comparison("gray", "baseline")
    assert said.startswith(f"The baseline is better for the {reader} reader than the gray (95%")
    errors = {name: found.error(name, reader).value for name in found.names}
    assert errors["gray"] > errors["baseline"] + 1.0
    difference = found.error_difference("baseline", "gray", reader)
    assert difference.value == pytest.approx(errors["gray"] - errors["baseline"])
    assert found.error_difference("gray", "baseline", reader).value == -difference.value
    read = found.rating("gray").read
    assert read is not None
    assert (read.reader_error_deg, read.normal_error_deg)[READERS.index(reader)] == pytest.approx(
        errors["gray"]
    )
