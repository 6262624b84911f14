"""Signals end a process, whatever it is doing."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
GREEDY = """
import time
try:
    print("importing", flush=True)
    time.sleep(0.5)
except BaseException:
    pass
"""
COMMAND = """
import time
from optimize.ui.process import Signals, run_process

def command():
    {block}
        import greedy
        time.sleep(20.0)
        print("worked on")

run_process(lambda: command)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("block", ["if True:", "with Signals().caught():"])
def test_a_signal_ends_a_process_whose_libraries_keep_to_themselves_what_imports_raise(
    tmp_path: Path, number: int, block: str
) -> None:
    (tmp_path / "greedy.py").write_text(GREEDY)
    (tmp_path / "command.py").write_text(COMMAND.format(block=block))
    with subprocess.Popen(
        [sys.executable, "command.py"],
        cwd=tmp_path,
        env={"PYTHONPATH": f"{ROOT}:{tmp_path}"},
        stdout=subprocess.PIPE,
        text=True,
        # Shells start what runs in the background without Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "importing\n"
        process.send_signal(number)
        assert process.stdout.read() == ""
    assert process.returncode != 0


REFUSING = """
import os, signal, sys
from optimize.ui.process import run_process

def command():
    try:
        raise ValueError
    except ValueError:
        print("no such scene", file=sys.stderr)
        os.kill(os.getpid(), signal.{name})
        sys.exit(2)

run_process(lambda: command)
"""


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_signal_while_a_command_says_its_last_words_has_its_own_exit_code(
    name: str, code: int
) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", REFUSING.format(name=name)],
        env={"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert (ended.returncode, ended.stderr) == (code, "no such scene\n")
