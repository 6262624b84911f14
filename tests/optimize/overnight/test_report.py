"""The report of a night says what the renders say, doubts what is doubtful, and stands alone."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from optimize.design import Design
from optimize.overnight.conclusion import outcome, surrogate_sentence
from optimize.overnight.report import convergence, render_report, warnings
from optimize.overnight.result import Finalist, OvernightResult
from optimize.report import bolt_pictures
from render.errors import SceneError
from render.scene import unchecked

pytestmark = pytest.mark.slow

Run = Callable[..., Any]


def changed(night: OvernightResult, key: str, **values: Any) -> OvernightResult:
    """Return the night with one finalist changed; ``score`` goes into its rating."""
    (entry,) = (e for e in night.finalists if e.key == key)
    rating = replace(entry.rating, score=values.pop("score", entry.score))
    new = replace(entry, rating=rating, **values)
    return replace(night, finalists=tuple(new if e is entry else e for e in night.finalists))


def won_by(night: OvernightResult, gain: float, se: float) -> OvernightResult:
    return changed(night, "winner", gain=gain, gain_se=se, score=night.finalists[0].score + gain)


def drawn_of(scene: object, entries: Sequence[Finalist]) -> list[tuple[str, bytes]]:
    """Return empty pictures of all finalists."""
    kinds = ("scheme", "metric", "facets")
    return [(f"{kind}-{entry.key}", b"") for entry in entries for kind in kinds]


def summary(night: OvernightResult) -> list[str]:
    return [
        *outcome(night.scene, night.finalists, night.winner, night.replicates, night.objective),
        surrogate_sentence(night.finalists, night.winner),
    ]


def test_the_report_needs_no_other_file_and_no_network(night_report: Path) -> None:
    html = night_report.read_text()
    sources = re.findall(r'(?:src|href)="([^"]*)"', html)
    # Sensor; scheme, map and facets of five finalists, six bolts, three plots, the wiring sheet's.
    assert len(sources) == 1 + 3 * 5 + 6 + 3 + 1
    assert all(re.match(r"data:image/(png|svg\+xml);base64,", source) for source in sources)
    assert not re.search(r"<script|<link|@import|url\(|https?://", html)


def test_the_command_rebuilds_the_report_from_the_files_alone(
    tactilux: Run, run_directory: Path, night_report: Path
) -> None:
    done = tactilux("report", run_directory)
    assert done.code == 0
    assert done.out == f"Report: {run_directory / 'report.html'}\n"
    assert (run_directory / "report.html").read_bytes() == night_report.read_bytes()


def test_a_report_that_cannot_be_written_is_one_sentence(
    tactilux: Run, run_directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Drawing the report takes seconds, and it is written after that.
    monkeypatch.setattr("optimize.overnight.report.render_report", lambda *_: "<html>")
    (run_directory / "report.html").mkdir()
    done = tactilux("report", run_directory)
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert "cannot be written" in done.err
    assert not list(run_directory.glob(".*"))


def test_a_directory_without_a_night_is_bad_input(tactilux: Run, tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "none"):
        done = tactilux("report", place)
        assert done.code == 2
        assert done.err.count("\n") == 1
        assert "no finished night" in done.err
    assert list(tmp_path.iterdir()) == []


def test_the_summary_states_gain_and_interval(finished_night: OvernightResult) -> None:
    text = summary(won_by(finished_night, 30.0, 1.0))
    base = finished_night.finalists[0].score
    # Student's t with 15 degrees of freedom.
    assert f"the gain is 30.0 ({30 / base:+.0%}), and its 95% interval reaches from 27.9" in text[0]


def test_the_summary_says_what_came_with_colors_and_what_with_directions(
    finished_night: OvernightResult,
) -> None:
    night = changed(won_by(finished_night, 30.0, 1.0), "colors", gain=24.0, gain_se=1.0)
    assert any("+24.0 came with the colors" in text for text in summary(night))
    assert any("+6.0 with the directions" in text for text in summary(night))


def test_the_summary_counts_the_predictions_that_held(finished_night: OvernightResult) -> None:
    winner = finished_night.best
    off = changed(finished_night, "winner", predicted=winner.score + 5.0)
    said = f"said {winner.score + 5:.2f} for this design, off by +5.00 (renders ±0.40)"
    assert said in summary(off)[-1]
    assert "Of 5 finalists it held for 4." in summary(off)[-1]


def test_an_interval_that_the_renders_cannot_test_is_not_said_to_hold(
    finished_night: OvernightResult,
) -> None:
    noisy = changed(finished_night, "winner", se=60.0)
    assert noisy.best.prediction_check == "cannot be tested"
    said = summary(noisy)[-1]
    assert "it held for 4, and for 1 the renders are too noisy to tell" in said


def test_an_interval_is_not_refuted_by_renders_that_have_not_converged(
    finished_night: OvernightResult,
) -> None:
    doubtful = changed(
        finished_night, "winner", predicted=finished_night.best.score + 50.0, converged=False
    )
    assert summary(doubtful)[-1].endswith(
        "cannot be tested. Of 5 finalists it held for 4, and for 1 the renders are too noisy to "
        "tell."
    )


def test_renders_that_have_not_converged_claim_no_gain(finished_night: OvernightResult) -> None:
    night = changed(won_by(finished_night, 39.0, 1.0), "baseline", converged=False)
    text = summary(night)
    assert "do not say which one is better" in text[0]
    assert not any("gain" in sentence for sentence in text)
    (doubt,) = warnings(night)
    assert doubt.startswith("Few light paths carry most of the light, so these renders decide")


def test_a_night_that_found_nothing_says_so(finished_night: OvernightResult) -> None:
    night = replace(
        finished_night, finalists=finished_night.finalists[:1], winner="baseline", verdict=()
    )
    assert "Nothing that was rendered beats the baseline" in summary(night)[0]
    assert warnings(night) == []


def test_a_sure_gain_needs_no_warning(finished_night: OvernightResult) -> None:
    assert warnings(won_by(finished_night, 39.0, 1.0)) == []


@pytest.mark.parametrize(
    ("gain", "se", "word"),
    [(1.0, 1.0, "more hours"), (-9.0, 1.0, "the baseline is better")],
)
def test_a_gain_that_is_not_sure_is_told(
    finished_night: OvernightResult, gain: float, se: float, word: str
) -> None:
    assert word in warnings(won_by(finished_night, gain, se))[0]


def test_a_better_finalist_than_the_winner_is_told(finished_night: OvernightResult) -> None:
    night = changed(won_by(finished_night, 39.0, 1.0), "thesis", score=500.0)
    assert "Thesis-style design scored" in warnings(night)[0]
    assert "they tie" in warnings(night)[0]


def test_a_monochrome_winner_and_clipping_are_flagged(finished_night: OvernightResult) -> None:
    night = won_by(finished_night, 39.0, 1.0)
    winner = night.best
    red = Design.of_colors(winner.design.phi, [0] * 20)
    found = warnings(changed(night, "winner", design=red, counts=np.full_like(winner.counts, 255)))
    assert "monochrome" in found[0]
    assert "saturate" in found[1]


def test_text_is_escaped_and_a_bare_night_still_has_a_report(
    finished_night: OvernightResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_small(*_: object) -> None:
        raise SceneError("a bolt does not fit")

    # Drawing a bolt takes seconds, and what stands in its place is tested here.
    monkeypatch.setattr("optimize.overnight.report.bolt_pictures", too_small)
    shown = (finished_night.finalists[0], finished_night.best)
    night = replace(
        finished_night, finalists=shown, steps=(), trade=(), facts=(("Model", "<fitted>"),)
    )
    html = render_report(night)
    assert "&lt;fitted&gt;" in html
    assert "No picture: a bolt does not fit." in html
    assert "Convergence" not in html
    assert "Speed and accuracy" not in html


def test_a_pad_too_small_for_a_bolt_is_refused(finished_night: OvernightResult) -> None:
    scene = finished_night.scene
    narrow = unchecked(scene, {"pad": unchecked(scene.pad, {"width": 6.0})})
    with pytest.raises(SceneError, match="does not fit into the pad"):
        bolt_pictures(narrow, [finished_night.best.design], finished_night.settings)


def test_the_bolt_is_seen_with_the_tip_at_the_top_as_in_all_pictures(
    finished_night: OvernightResult,
) -> None:
    scene = finished_night.scene
    ((png, *_),) = bolt_pictures(scene, [finished_night.best.design], finished_night.settings)
    height, width = imread(io.BytesIO(png)).shape[:2]
    # The pad is longer than wide, and lies along the picture's height.
    assert height / width == pytest.approx(scene.pad.length / scene.pad.width, rel=0.35)


def test_convergence_shows_every_rendered_design_with_its_error_bar(
    finished_night: OvernightResult,
) -> None:
    (axes,) = convergence(finished_night).axes
    bars = [part for part in axes.containers if hasattr(part, "has_yerr") and part.has_yerr]
    shown = sorted(float(y) for bar in bars for y in bar.lines[0].get_ydata())
    assert shown == pytest.approx(sorted(step.value for step in finished_night.steps))
    best = max(step.value for step in finished_night.steps)
    assert any(np.max(line.get_ydata()) == pytest.approx(best) for line in axes.lines)


def test_finalists_and_verdict_are_shown_as_they_are_and_no_sentence_twice(
    night_report: Path, finished_night: OvernightResult
) -> None:
    html = night_report.read_text()
    for entry in finished_night.finalists:
        assert f"<td>{entry.title}</td>" in html
    first, *others = finished_night.verdict
    assert f'<p class="lead">{first}</p>' in html
    for sentence in others:
        assert f"<li>{sentence}</li>" in html
    text = re.sub(r"<style.*?</style>|data:image[^\"]*", "", html, flags=re.DOTALL)
    sentences = re.findall(r"[A-Z][^.<>]{40,}\.", re.sub(r"<[^>]+>", "\n", text))
    assert len(sentences) == len(set(sentences))


def test_the_report_ends_with_the_time_of_more_workers(
    finished_night: OvernightResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("optimize.overnight.report.bolt_pictures", lambda *_: [[], []])
    scaling = {1: 7200.0, 2: 3700.0, 8: 1100.0, 64: 400.0}
    html = render_report(finished_night, scaling)
    assert html.index("More workers") > html.index("Wiring sheet")
    assert html.index("More workers") > html.index("Origin")
    text = " ".join(re.sub(r"<[^>]+>", " ", html).split())
    for row in ("1 2:00:00 1", "2 1:01:40 1.9", "8 18:20 6.5", "64 6:40 18"):
        assert f" {row} " in text
    assert "other work does not shrink" in text


@pytest.mark.parametrize("se", [0.4, 60.0])
def test_table_and_sentence_judge_intervals_by_one_rule(
    finished_night: OvernightResult, monkeypatch: pytest.MonkeyPatch, se: float
) -> None:
    # Pictures take seconds, and none is looked at.
    monkeypatch.setattr("optimize.overnight.report.bolt_pictures", lambda *_: [[], []])
    monkeypatch.setattr("optimize.overnight.report.design_pictures", drawn_of)
    winner = finished_night.best
    night = changed(finished_night, "winner", predicted=winner.score + 3.0, se=se)
    html = render_report(replace(night, steps=(), trade=()))
    cells = re.findall(r'<td class="extra">(yes|no|cannot tell)</td>', html)
    assert len(cells) == len(night.finalists)
    said = summary(night)[-1]
    assert f"it held for {cells.count('yes')}" in said
    assert ("does not hold" in said) == (cells[-2] == "no")
    assert ("too noisy to tell" in said) == ("cannot tell" in cells)


def test_colors_that_won_nothing_get_no_part_of_the_gain(finished_night: OvernightResult) -> None:
    night = changed(won_by(finished_night, 30.0, 1.0), "colors", gain=-4.0, gain_se=1.0)
    assert not any("came with the colors" in text for text in summary(night))


def read_night(night: OvernightResult, gain: float, se: float) -> OvernightResult:
    """Return the night of a reader, whose winner misses normals by so many degrees more."""
    figure = night.finalists[0].errors["sensor"]
    won = replace(figure, value=figure.value + gain, gain=gain, gain_se=se)
    place = replace(won, value=1.0)
    night = changed(night, "winner", errors={"sensor": won, "place": place})
    finalists = tuple(
        entry if entry.key in {"baseline", "winner"}
        else replace(entry, errors=dict.fromkeys(("sensor", "place"), replace(figure, value=9.0)))
        for entry in night.finalists
    )  # fmt: skip
    return replace(night, finalists=finalists, objective="sensor")


def test_a_night_for_a_reader_is_told_in_degrees(finished_night: OvernightResult) -> None:
    night = read_night(finished_night, -0.8, 0.05)
    text = summary(night)
    assert text[0].startswith(
        "The sensor reader misses surface normals of the design by 1.40° ± 0.04°, those of the "
        "baseline by 2.20° ± 0.04°. Rendered with the same seeds, the difference is "
        "-0.80° (-36%), and its 95% interval reaches from -0.91° to -0.69°."
    )
    assert text[1].startswith("The place reader misses 1.00° (2.20° with the baseline) and S is ")
    assert warnings(night) == []
    assert "baseline is better" in warnings(read_night(finished_night, 0.8, 0.05))[0]
    assert "reaches 0" in warnings(read_night(finished_night, -0.08, 0.05))[0]
    nothing = replace(night, winner="baseline")
    assert summary(nothing)[0] == (
        "Nothing that was rendered beats the baseline, read by the sensor reader to 2.20° ± 0.04°."
    )
    (axes,) = convergence(night).axes
    assert axes.get_ylabel() == "sensor reader, deg"
