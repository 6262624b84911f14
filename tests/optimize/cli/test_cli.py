"""The command line is quick to import, and tells every kind of failure apart."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from optimize.cli import main

HEAVY = {"numpy", "pydantic", "torch", "mitsuba", "cma", "matplotlib", "moderngl", "onnxruntime"}
COMMANDS = (
    "explore",
    "verify",
    "optimize",
    "sensitivity",
    "reconstruct",
    "train",
    "render",
    "describe",
    "colors",
    "schema",
    "new",
)


def call(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["tactilux", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    return int(end.value.code or 0)


def test_nothing_heavy_is_imported_for_help() -> None:
    code = "import sys, optimize.cli; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=True,
    )
    assert not HEAVY & set(done.stdout.split())


def test_help_names_every_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(monkeypatch, "--help") == 0
    said = capsys.readouterr().out
    assert all(f"  {command} " in said for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    assert call(monkeypatch, command, "--help") == 0
    assert "Usage" in capsys.readouterr().out


def test_version_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(monkeypatch, "--version") == 0
    said = capsys.readouterr().out
    assert said.startswith("tactilux ")
    assert said.count("\n") == 1


def test_an_interrupt_ends_with_130(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("render.scene.load_scene", interrupt)
    assert call(monkeypatch, "describe") == 130


def test_a_missing_extra_is_one_sentence() -> None:
    # A process of its own, in which nothing has imported torch yet.
    code = "import sys; sys.modules['torch'] = None; from optimize.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "train"],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert 'pip install ".[train]"' in done.stderr


def test_a_mistake_of_the_program_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("render.scene.load_scene", fail)
    monkeypatch.setattr(sys, "argv", ["tactilux", "describe"])
    with pytest.raises(ZeroDivisionError):
        main()
