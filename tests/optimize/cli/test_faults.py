"""Whatever a disk, a pipe or a signal does, a command ends as the help says, without a traceback.

`tests/validation/test_faults.py` tries all commands, faults and random instants.
"""

from __future__ import annotations

import gc
import json
import re
import signal
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from optimize.cli import main
from optimize.ui import process
from optimize.ui.process import EXIT_CODES, Terminated, interruption
from render.errors import RenderError
from render.scene import load_scene
from render.transport import TransportTable
from tests.optimize.cli.faults import ROOT, SIGNALS, STREAMS, check, run

pytestmark = pytest.mark.slow


@pytest.fixture(scope="session")
def one_node(small_reference: TransportTable, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the table of a single direction."""
    whole = small_reference
    assert whole.background is not None
    assert whole.background_se is not None
    path = tmp_path_factory.mktemp("table") / "one.npz"
    replace(
        whole, T=whole.T[:, 3:4], se=whole.se[:, 3:4], phi=whole.phi[3:4], lam=30.0,
        background=whole.background[:, 3:4], background_se=whole.background_se[:, 3:4],
    ).save(path)  # fmt: skip
    return path


@pytest.mark.parametrize("fault", STREAMS)
@pytest.mark.parametrize("words", [("--help",), ("describe", "finger20", "--json")], ids=" ".join)
def test_no_stream_breaks_a_command(words: tuple[str, ...], fault: str, tmp_path: Path) -> None:
    ended = run(words, tmp_path, fault)
    check(ended, tmp_path, (2,) if fault == "stdout full" else (0,))
    if fault == "stdout full":
        assert ended.err.startswith("tactilux: the standard output cannot be written (No space")
        assert ended.err.count("\n") == 1


def test_a_search_whose_notes_nobody_reads_ends_with_its_result(
    small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    words = ("explore", small_scene, "--model", small_model, "--out", "result")
    check(run(words, tmp_path, "nobody reads"), tmp_path, (0,))
    assert json.loads((tmp_path / "result" / "result.json").read_text())["design"]


@pytest.mark.parametrize(
    "words",
    ["describe DEVICE", "score DEVICE", "verify DEVICE", "compare DEVICE DEVICE", "wiring DEVICE",
     "check --capture DEVICE", "colors DEVICE", "describe PROFILE"],
)  # fmt: skip
def test_a_device_in_place_of_a_file_is_refused_unread(tmp_path: Path, words: str) -> None:
    (tmp_path / "led.ies").symlink_to("/dev/zero")
    finger24 = (ROOT / "render" / "scenes" / "finger24.toml").read_text()
    profile = re.sub(r"profile = .*", 'profile = { file = "led.ies", source = "x" }', finger24)
    assert profile != finger24
    (tmp_path / "measured.toml").write_text(profile)
    named = {"DEVICE": "/dev/zero", "PROFILE": "measured.toml"}
    asked = tuple(named.get(word, word) for word in words.split())
    ended = run(asked, tmp_path, "6 GiB of addresses")
    check(ended, tmp_path, (2,))
    assert "it is a device, no file" in ended.err


def test_a_full_disk_is_one_sentence_and_leaves_nothing(
    small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    words = ("explore", small_scene, "--model", small_model, "--out", "result")
    ended = run(words, tmp_path, "room for 3 kB")
    check(ended, tmp_path, (2,))
    assert ended.err.splitlines()[-1].startswith("tactilux: ")
    assert "make room" in ended.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("sent", list(SIGNALS), ids=lambda number: number.name)
@pytest.mark.parametrize("after", [0.05, 0.15, 0.3, 0.6])
def test_a_signal_ends_a_command_at_any_instant_of_its_start(
    one_node: Path, tmp_path: Path, sent: signal.Signals, after: float
) -> None:
    ended = run(("colors", one_node, "--method", "exact"), tmp_path, sent=sent, after=after)
    check(ended, tmp_path, (0, *SIGNALS[sent]))


def test_a_signal_inside_a_library_is_known_by_what_it_wraps() -> None:
    def wrapped(signaled: BaseException) -> int | None:
        try:
            try:
                raise signaled
            except KeyboardInterrupt as error:
                raise RuntimeError("dr.while_loop(): encountered an exception") from error
        except RuntimeError as error:
            return interruption(error)

    assert wrapped(KeyboardInterrupt()) == 130
    assert wrapped(Terminated()) == 143
    assert interruption(RenderError("no light")) is None


def failing(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> int:
    """Return the exit code of a command in which ``error`` is raised."""

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("render.scene.load_scene", fail)
    monkeypatch.setattr(sys, "argv", ["tactilux", "describe"])
    with pytest.raises(SystemExit) as end:
        main()
    return int(end.value.code or 0)


@pytest.mark.parametrize(
    ("error", "code", "sentence"),
    [
        (OSError(28, "No space left on device", "x"), 2, "x: No space left on device; make room"),
        (PermissionError(13, "Permission denied", "x"), 2, "x: Permission denied; choose another"),
        (BrokenPipeError(32, "Broken pipe"), 2, "Broken pipe; "),
        (MemoryError(), 2, "there is not enough memory"),
        (Terminated(), 143, "interrupted"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)  # fmt: skip
def test_what_the_machine_does_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    sentence: str,
) -> None:
    assert failing(monkeypatch, error) == code
    said = capfd.readouterr()
    assert said.out == ""
    assert said.err.startswith(f"tactilux: {sentence}")
    assert said.err.count("\n") == 1


def test_a_signal_while_the_commands_are_put_together_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        raise Terminated

    monkeypatch.setattr("typer.main.get_command", interrupt)
    monkeypatch.setattr(sys, "argv", ["tactilux", "describe"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 143
    assert capfd.readouterr().err == "tactilux: interrupted\n"


def test_a_signal_that_comes_in_a_destructor_is_raised_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    raised: list[int] = []

    class Timer:
        def __init__(self, seconds: float, function: Any, arguments: list[int]) -> None:
            raised.extend(arguments)

        def start(self) -> None:
            raised.append(0)

    class Interrupted:
        def __del__(self) -> None:
            raise KeyboardInterrupt

    monkeypatch.setattr(process.threading, "Timer", Timer)
    monkeypatch.setattr(sys, "unraisablehook", process._unraisable)
    thing = Interrupted()
    del thing
    gc.collect()
    assert raised == [threading.main_thread().ident, signal.SIGINT, 0]


def test_a_cache_that_cannot_be_kept_is_one_sentence_without_source(
    small_scene: Path, tmp_path: Path
) -> None:
    ended = run(("render", small_scene, "--out", "picture.png"), tmp_path, "cache is a device")
    check(ended, tmp_path, (0,))
    assert "tactilux: the slab response cannot be cached: " in ended.err
    assert "warnings.warn" not in ended.err
    assert "atplotlib" not in ended.err
    assert (tmp_path / "picture.png").is_file()


def test_a_scene_file_may_begin_with_a_byte_order_mark(small_scene: Path, tmp_path: Path) -> None:
    marked = tmp_path / "marked.toml"
    marked.write_bytes(b"\xef\xbb\xbf" + small_scene.read_bytes())
    assert load_scene(marked) == load_scene(small_scene)


def test_help_says_the_exit_codes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["tactilux", "--help"])
    with pytest.raises(SystemExit):
        main()
    assert EXIT_CODES in " ".join(capsys.readouterr().out.split())


def test_the_shell_completes_commands(tmp_path: Path) -> None:
    asked = {"_TACTILUX_COMPLETE": "complete_bash", "COMP_WORDS": "tactilux re", "COMP_CWORD": "1"}
    ended = run((), tmp_path, environment=asked)
    assert set(ended.out.split()) == {"reconstruct", "render", "report"}
