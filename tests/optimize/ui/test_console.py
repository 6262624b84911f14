"""Results alone reach stdout; progress appears on stderr when work takes long."""

from __future__ import annotations

import ctypes
import json

import pytest

from optimize.ui import console
from render.progress import Progress


def test_what_libraries_print_goes_to_stderr(capfd: pytest.CaptureFixture[str]) -> None:
    with console.reserved_stdout() as stream:
        print("from Python", flush=True)
        ctypes.CDLL(None).puts(b"from C")
        console.print_json(stream, {"score": 1.5})
    said = capfd.readouterr()
    assert json.loads(said.out) == {"score": 1.5}
    assert said.err == "from Python\nfrom C\n"
    print("back", flush=True)
    assert capfd.readouterr().out == "back\n"


def test_a_number_that_json_cannot_hold_is_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    with (
        console.reserved_stdout() as stream,
        pytest.raises(ValueError, match="not JSON compliant"),
    ):
        console.print_json(stream, {"score": float("nan")})
    assert capfd.readouterr().out == ""


def test_short_work_shows_no_progress(capfd: pytest.CaptureFixture[str]) -> None:
    with console.ProgressBar("Quick") as bar:
        bar(Progress(1, 2))
    assert capfd.readouterr().err == ""


def test_long_work_in_a_log_says_how_long_it_will_take(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.ProgressBar("Rendering") as bar:
        for step in range(1, 5):
            now[0] = 60.0 * step
            bar(Progress(step, 8))
        bar(Progress(4, 8, eta_seconds=3725.0))
    lines = capfd.readouterr().err.splitlines()
    assert lines[0] == "Rendering: 12 %, 7:00 left"
    assert lines[-1] == "Rendering: 50 %, 4:00 left"


def test_a_stage_is_announced_named_in_the_log_and_timed_by_itself(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.ProgressBar("Fitting", announce=True) as bar:
        for stage in ("ridge", "networks"):
            bar(Progress(0, 4, stage=stage))
            now[0] += 60.0
            bar(Progress(1, 4, stage=stage))
    assert capfd.readouterr().err.splitlines() == [
        "Fitting ridge ...",
        "Fitting ridge: 25 %, 3:00 left",
        "Fitting networks ...",
        "Fitting networks: 25 %, 3:00 left",
    ]


def test_one_of_a_kind_is_said_in_the_singular() -> None:
    assert console.counted(1, "attempt") == "1 attempt"
    assert console.counted(2, "attempt") == "2 attempts"
