"""The report of a night says what the renders say, doubts what is doubtful, and stands alone."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.design import Design
from optimize.overnight.figures import bolt_pictures, convergence, timed_levels
from optimize.overnight.report import prediction_check, render_report, summary, warnings
from optimize.overnight.result import OvernightResult
from optimize.overnight.scaling import Scaling, keep_scaling, scaling_rows
from render.errors import SceneError

Run = Callable[..., Any]


def changed(night: OvernightResult, key: str, **values: Any) -> OvernightResult:
    """Return the night with one finalist changed."""
    finalists = [replace(e, **values) if e.key == key else e for e in night.finalists]
    return replace(night, finalists=tuple(finalists))


def won_by(night: OvernightResult, gain: float, se: float) -> OvernightResult:
    return changed(night, "winner", gain=gain, gain_se=se, score=night.finalists[0].score + gain)


def test_the_report_needs_no_other_file_and_no_network(night_report: Path) -> None:
    html = night_report.read_text()
    sources = re.findall(r'(?:src|href)="([^"]*)"', html)
    # Scheme, map and facets of five finalists, six bolts, four plots, and the wiring sheet's.
    assert len(sources) == 3 * 5 + 6 + 4 + 1
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert not re.search(r"<script|<link|@import|url\(|https?://", html)


def test_the_command_rebuilds_the_report_from_the_files_alone(
    tactilux: Run, run_directory: Path, night_report: Path, night_scaling: Scaling
) -> None:
    keep_scaling(run_directory, night_scaling)
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
        assert "night.json cannot be read" in done.err
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
    winner = finished_night.finalist("winner")
    off = changed(finished_night, "winner", predicted=winner.score + 5.0)
    said = f"said {winner.score + 5:.1f} for this design; its 90% interval held for 4 of 5"
    assert said in summary(off)[-1]


def test_an_interval_that_the_renders_cannot_test_is_not_said_to_hold(
    finished_night: OvernightResult,
) -> None:
    noisy = changed(finished_night, "winner", se=60.0)
    assert prediction_check(noisy.finalist("winner")) == "cannot be tested"
    said = summary(noisy)[-1]
    assert "held for 4 of 5 finalists, and for 1 of them the renders are too noisy to tell" in said


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
    assert "Thesis procedure scored higher" in warnings(night)[0]


def test_a_monochrome_winner_and_clipping_are_flagged(finished_night: OvernightResult) -> None:
    night = won_by(finished_night, 39.0, 1.0)
    winner = night.finalist("winner")
    red = Design.of_colors(winner.design.phi, [0] * 20)
    found = warnings(changed(night, "winner", design=red, counts=np.full_like(winner.counts, 255)))
    assert "monochrome" in found[0]
    assert "saturate" in found[1]


def test_text_is_escaped_and_a_bare_night_still_has_a_report(
    finished_night: OvernightResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_small(night: OvernightResult) -> dict[tuple[str, int], bytes]:
        raise SceneError("a bolt does not fit")

    # Drawing a bolt takes seconds, and what stands in its place is tested here.
    monkeypatch.setattr("optimize.overnight.report.bolt_pictures", too_small)
    shown = tuple(finished_night.finalist(key) for key in ("baseline", "winner"))
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
    narrow = scene.model_copy(update={"pad": scene.pad.model_copy(update={"width": 6.0})})
    with pytest.raises(SceneError, match="does not fit into the pad"):
        bolt_pictures(replace(finished_night, scene=narrow))


def test_levels_without_a_time_or_an_error_are_not_drawn(finished_night: OvernightResult) -> None:
    night = replace(
        finished_night,
        trade=(*finished_night.trade, {"level": "guess", "seconds_per_design": None}),
    )
    names = [row["level"] for row in timed_levels(night)]
    assert names == ["checker.onnx", "preview", "PSSMLT, 96 samples"]


def test_convergence_shows_every_rendered_design_with_its_error_bar(
    finished_night: OvernightResult,
) -> None:
    (axes,) = convergence(finished_night).axes
    bars = [part for part in axes.containers if hasattr(part, "has_yerr") and part.has_yerr]
    shown = sorted(float(y) for bar in bars for y in bar.lines[0].get_ydata())
    assert shown == pytest.approx(sorted(step.score for step in finished_night.steps))
    best = max(step.score for step in finished_night.steps)
    assert any(np.max(line.get_ydata()) == pytest.approx(best) for line in axes.lines)


def test_finalists_and_verdict_are_shown_as_they_are(
    night_report: Path, finished_night: OvernightResult
) -> None:
    html = night_report.read_text()
    for entry in finished_night.finalists:
        assert f"<td>{entry.title}</td>" in html
    for sentence in finished_night.verdict:
        assert f"<li>{sentence}</li>" in html


def test_the_report_states_the_time_of_more_workers(
    night_report: Path, night_scaling: Scaling
) -> None:
    text = " ".join(re.sub(r"<[^>]+>", " ", night_report.read_text()).split())
    for row in scaling_rows(night_scaling):
        assert f" {' '.join(row)} " in text
    assert "Simulated from this night's 60 renders" in text.replace("&#39;", "'")


def test_colors_that_won_nothing_get_no_part_of_the_gain(finished_night: OvernightResult) -> None:
    night = changed(won_by(finished_night, 30.0, 1.0), "colors", gain=-4.0, gain_se=1.0)
    assert not any("came with the colors" in text for text in summary(night))
