"""A whole night of a tiny sensor: what it leaves, and that no interruption changes it."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.overnight.report import write_report
from optimize.overnight.result import DESIGNS, NIGHT, OvernightResult
from optimize.overnight.status import status_of
from optimize.overnight.store import RENDERS
from tests.long import LONG
from tests.optimize.overnight.conftest import SAMPLES, TinyNight
from tests.optimize.overnight.tiny import outcome
from tests.optimize.overnight.warm import FIT_STEPS, WarmProgram, WarmRun, wait_for

pytestmark = pytest.mark.slow

# In the order of the night: a stage that is through is not begun again.
ENDED_IN = (("Surrogate", signal.SIGTERM), ("Round 2", signal.SIGKILL))
if LONG:
    ENDED_IN = (
        ("Transport table", signal.SIGKILL),
        ("Surrogate", signal.SIGTERM),
        ("Surrogate", signal.SIGKILL),
        ("Round 2", signal.SIGTERM),
        ("Round 2", signal.SIGKILL),
        ("Final verification", signal.SIGKILL),
    )
DAY = 86400.0
Run = Callable[..., Any]


def test_the_night_is_complete_and_its_files_load(tiny_night: TinyNight) -> None:
    night = OvernightResult.load(tiny_night.run)
    keys = [entry.key for entry in night.finalists]
    assert keys == ["baseline", "score", "thesis", "winner", "runner-up"]
    assert all(np.isfinite(entry.score) and entry.se > 0 for entry in night.finalists)
    assert night.winner in keys
    for entry in night.finalists:
        parts = entry.rating.mean - entry.rating.spread_sites - entry.rating.spread_bends
        assert entry.score == pytest.approx(parts, abs=1e-9)
    assert [step.step for step in night.steps[:: len(night.steps) - 1]] == ["round 1", "final"]
    assert (tiny_night.run / "report.html").stat().st_size > 10_000
    assert not [path for path in tiny_night.run.rglob("*") if path.suffix in (".pkl", ".pickle")]


def test_programs_are_told_of_stages_and_of_the_outcome(tiny_night: TinyNight) -> None:
    *events, result = tiny_night.events
    stages = [event["stage"] for event in events if event["event"] == "stage"]
    assert stages[0] == "Transport table"
    assert stages[-1] == "Report"
    assert result["winner"] in result["finalists"]  # type: ignore[operator]
    assert Path(str(result["design"])).is_file()
    assert Path(str(result["report"])).is_file()


def test_the_log_has_a_time_stamp_on_every_line(tiny_night: TinyNight) -> None:
    lines = (tiny_night.run / "log.txt").read_text().splitlines()
    stamp = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d\d:\d\d ")
    assert len(lines) > 10
    assert all(stamp.match(line) for line in lines)


def test_the_verdict_says_every_sentence_once_and_the_terminal_leaves_it_to_the_result(
    tiny_night: TinyNight,
) -> None:
    verdict = OvernightResult.load(tiny_night.run).verdict
    assert len(set(verdict)) == len(verdict) > 2
    log = (tiny_night.run / "log.txt").read_text()
    assert all(log.count(sentence) == 1 for sentence in verdict)
    assert not any(sentence in tiny_night.said for sentence in verdict)


def test_status_tells_a_program_that_it_is_finished(tactilux: Run, tiny_night: TinyNight) -> None:
    found = json.loads(tactilux("status", tiny_night.run, "--json").out)
    assert found["state"] == "finished"
    assert (found["best"]["level"], found["best"]["effort"]) == ("reference", None)
    assert found["evaluations"] == len(list((tiny_night.run / RENDERS).iterdir()))
    assert 0 < found["render_seconds"] < found["seconds"] < 2 * tiny_night.seconds
    assert found["eta_seconds"] is None


def test_a_finished_night_with_a_damaged_file_is_mended_from_its_renders(
    tactilux: Run, tiny_night: TinyNight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("optimize.overnight.report.write_report", lambda result, run: None)
    monkeypatch.setattr("optimize.overnight.context.FIT_STEPS", (FIT_STEPS, FIT_STEPS))
    run = tmp_path / "run"
    shutil.copytree(tiny_night.run, run)
    (run / NIGHT).write_bytes((run / NIGHT).read_bytes()[:-100])
    (run / DESIGNS / "winner.json").unlink()
    mended = tactilux("overnight", tiny_night.scene, "--out", run, "--samples", SAMPLES)
    assert mended.code == 0, mended.err
    assert "night.npz is no finished night" in mended.err
    assert outcome(run) == outcome(tiny_night.run)


def test_interrupts_kills_one_core_and_a_jumping_clock_change_nothing(
    tactilux: Run, tiny_night: TinyNight, warm_program: WarmProgram, tmp_path: Path
) -> None:
    run, rng = tmp_path / "run", random.Random(3)
    words = ("overnight", tiny_night.scene, "--out", run, "--samples", SAMPLES)

    def attempt(ahead: float) -> WarmRun:
        """Start the night with the clock on the wall ahead by so many seconds."""
        return warm_program.start(*words, ahead=ahead, report=False)

    first = attempt(DAY)
    wait_for(run, "Transport table", first)
    assert status_of(run).state == "running"
    second = tactilux(*words)
    assert second.code == 2
    assert f"is in use by process {first.pid} on " in second.err
    first.send(signal.SIGINT)
    began = time.monotonic()
    code, said = first.wait()
    assert code == 128 + signal.SIGINT, said
    assert "give the same command again to go on" in said
    assert "Traceback" not in said
    assert time.monotonic() - began < max(10.0, tiny_night.seconds / 2)
    assert status_of(run).state == "stopped"

    for number, (stage, ending) in enumerate(ENDED_IN):
        known = len((run / "log.txt").read_text())
        process = attempt(-DAY if number % 2 else DAY)
        # On one core, as the last attempt is not: what sums come to must not depend on it.
        os.sched_setaffinity(process.pid, {min(os.sched_getaffinity(0))})
        wait_for(run, stage, process, known)
        time.sleep(rng.uniform(0.0, 0.03) * tiny_night.seconds)
        process.send(ending)
        code, _ = process.wait()
        killed = ending == signal.SIGKILL
        assert code == (-ending if killed else 128 + ending)
        assert status_of(run).state == ("lost" if killed else "stopped")

    last = attempt(-DAY)
    code, said = last.wait()
    assert code == 0, said
    assert outcome(run) == outcome(tiny_night.run)
    assert status_of(run).attempts == 2 + len(ENDED_IN)


def test_the_wiring_sheet_of_a_night_says_what_rounding_angles_takes(
    tiny_night: TinyNight, tmp_path: Path
) -> None:
    html = (tiny_night.run / "report.html").read_text()
    said = re.search(r"the design scores ([\d.]+) so, and ([\d.]+) with angles as found; "
                     r"rounding takes (-?[\d.]+) counts", html)  # fmt: skip
    assert said is not None
    rounded, found, price = map(float, said.groups())
    assert price == pytest.approx(found - rounded, abs=0.11)  # of tenths
    assert "5° of every fiber&#39;s angle" in html
    # A copy without the model has no price, and is a report all the same.
    night = OvernightResult.load(tiny_night.run)
    shutil.copy(tiny_night.run / "scene.toml", tmp_path)
    assert "Angles are rounded to 5°.</" in write_report(night, tmp_path).read_text()
