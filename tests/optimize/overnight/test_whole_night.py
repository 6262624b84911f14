"""A whole night of a tiny sensor: what it leaves, and that no interruption changes it."""

from __future__ import annotations

import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.overnight.result import ARRAYS, DESIGNS, NIGHT, OvernightResult
from optimize.overnight.status import status_of
from optimize.overnight.store import RENDERS
from tests.long import LONG
from tests.optimize.overnight.tiny import ROOT, rows, start, write_tiny

SAMPLES = 8
KILLED_IN = ("Surrogate", "Round 2")
if LONG:
    KILLED_IN = ("Transport table", *KILLED_IN, "Final verification")
# The report is drawn from the files of a night that has ended; of these nights nobody reads it.
CLOCK = """
import sys, time
shift, real = float(sys.argv.pop(1)), time.time
time.time = lambda: real() + shift
import optimize.overnight.job
optimize.overnight.job.write_report = lambda result, run: None
from hw.cli import main
main()
"""
DAY = 86400.0
Run = Callable[..., Any]


@dataclass(frozen=True)
class Unbroken:
    """A night that nothing disturbed, and what it said."""

    scene: Path
    run: Path
    events: list[dict[str, object]]
    seconds: float


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> Unbroken:
    folder = tmp_path_factory.mktemp("night")
    scene, run = write_tiny(folder), folder / "run"
    began = time.monotonic()
    process = start("overnight", scene, "--out", run, "--samples", SAMPLES, "--json-lines")
    out, said = process.communicate()
    assert process.returncode == 0, said
    return Unbroken(
        scene, run, [json.loads(line) for line in out.splitlines()], time.monotonic() - began
    )


def outcome(run: Path) -> dict[str, object]:
    """Return everything of a run but the seconds that it took."""
    files = [ARRAYS, "model/checker.onnx", "table/reference.npz", "scene.toml"]
    files += [f"{DESIGNS}/{path.name}" for path in sorted((run / DESIGNS).iterdir())]
    files += [f"{RENDERS}/{path.name}" for path in sorted((run / RENDERS).iterdir())]
    night = json.loads((run / NIGHT).read_text())
    kept = ("scene_hash", "replicates", "finalists", "winner", "verdict", "files")
    decisions = rows(run, "SELECT name, value FROM decisions ORDER BY name")
    return {
        **{name: hashlib.sha256((run / name).read_bytes()).hexdigest() for name in files},
        **{name: night[name] for name in kept},
        "decisions": [r for r in decisions if not str(r[0]).endswith(("/model", "/finished"))],
        "evaluations": rows(run, "SELECT key, sha256 FROM evaluations ORDER BY key"),
    }


def test_the_night_is_complete_and_its_files_load(unbroken: Unbroken) -> None:
    night = OvernightResult.load(unbroken.run)
    keys = [entry.key for entry in night.finalists]
    assert keys == ["baseline", "colors", "thesis", "winner", "runner-up"]
    assert all(np.isfinite(entry.score) and entry.se > 0 for entry in night.finalists)
    assert night.winner in keys
    assert {step.stage for step in night.steps} == {"rounds", "final"}
    assert (unbroken.run / "report.html").stat().st_size > 10_000
    assert not [path for path in unbroken.run.rglob("*") if path.suffix in (".pkl", ".pickle")]


def test_programs_are_told_of_stages_and_of_the_outcome(unbroken: Unbroken) -> None:
    *events, result = unbroken.events
    stages = [event["stage"] for event in events if event["event"] == "stage"]
    assert stages[0] == "Transport table"
    assert stages[-1] == "Report"
    assert result["winner"] in result["finalists"]  # type: ignore[operator]
    assert Path(str(result["design"])).is_file()
    assert Path(str(result["report"])).is_file()


def test_the_log_has_a_time_stamp_on_every_line(unbroken: Unbroken) -> None:
    lines = (unbroken.run / "log.txt").read_text().splitlines()
    stamp = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d\d:\d\d ")
    assert len(lines) > 10
    assert all(stamp.match(line) for line in lines)


def test_status_tells_a_program_that_it_is_finished(tactilux: Run, unbroken: Unbroken) -> None:
    found = json.loads(tactilux("status", unbroken.run, "--json").out)
    assert found["state"] == "finished"
    assert found["best"]["level"] == "reference"
    assert found["evaluations"] == len(list((unbroken.run / RENDERS).iterdir()))
    assert 0 < found["render_seconds"] < found["seconds"] < 2 * unbroken.seconds
    assert found["eta_seconds"] is None


def test_a_finished_night_with_a_damaged_file_is_mended_from_its_renders(
    tactilux: Run, unbroken: Unbroken, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("optimize.overnight.job.write_report", lambda night, run: None)
    run = tmp_path / "run"
    shutil.copytree(unbroken.run, run)
    (run / ARRAYS).write_bytes((run / ARRAYS).read_bytes()[:-100])
    mended = tactilux("overnight", unbroken.scene, "--out", run, "--samples", SAMPLES)
    assert mended.code == 0, mended.err
    assert "is not the file that night.json was written with" in mended.err
    assert outcome(run) == outcome(unbroken.run)


def wait_for(run: Path, stage: str, process: subprocess.Popen[str], known: int = 0) -> None:
    """Wait until the log names ``stage`` behind its first ``known`` characters."""
    log = run / "log.txt"
    while process.poll() is None:
        if log.is_file() and f"{stage} ..." in log.read_text()[known:]:
            return
        time.sleep(0.02)
    raise AssertionError(f"it ended before {stage}")


def test_interrupts_kills_and_a_jumping_clock_change_nothing(
    unbroken: Unbroken, tmp_path: Path
) -> None:
    run, rng = tmp_path / "run", random.Random(3)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}

    def attempt(shift: float) -> subprocess.Popen[str]:
        """Start the night with the clock on the wall shifted by so many seconds."""
        words = ["overnight", str(unbroken.scene), "--out", str(run), "--samples", str(SAMPLES)]
        return subprocess.Popen(
            [sys.executable, "-c", CLOCK, str(shift), *words],
            cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    first = attempt(DAY)
    wait_for(run, "Transport table", first)
    first.send_signal(signal.SIGINT)
    began = time.monotonic()
    _, said = first.communicate()
    assert first.returncode == 130, said
    assert "give the same command again to go on" in said
    assert "Traceback" not in said
    assert time.monotonic() - began < max(10.0, unbroken.seconds / 2)
    assert status_of(run).state == "stopped"

    for number, stage in enumerate(KILLED_IN):
        known = len((run / "log.txt").read_text())
        killed = attempt(-DAY if number % 2 else DAY)
        wait_for(run, stage, killed, known)
        time.sleep(rng.uniform(0.0, 0.03) * unbroken.seconds)
        os.kill(killed.pid, signal.SIGKILL)
        killed.communicate()
        assert status_of(run).state == "lost"

    last = attempt(-DAY)
    _, said = last.communicate()
    assert last.returncode == 0, said
    assert outcome(run) == outcome(unbroken.run)
    assert status_of(run).attempts == 2 + len(KILLED_IN)


def test_a_second_process_refuses_and_names_the_first(
    tactilux: Run, unbroken: Unbroken, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    words = ("overnight", unbroken.scene, "--out", run, "--samples", SAMPLES)
    first = start(*words)
    try:
        wait_for(run, "Transport table", first)
        assert status_of(run).state == "running"
        second = tactilux(*words)
        assert second.code == 2
        assert f"is in use by process {first.pid} on " in second.err
    finally:
        first.terminate()
        first.communicate()
    assert first.returncode == 128 + signal.SIGTERM
