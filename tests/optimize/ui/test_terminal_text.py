"""What strangers name things steers no terminal, whichever way it reaches it."""

from __future__ import annotations

import io
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from optimize.ui.console import note, print_table
from optimize.ui.terminal_text import one_line, printable

ROOT = Path(__file__).parents[3]
HOSTILE = "\x1b]0;pwn\x07[red]a[/red]\x9b31m\u202eb\r\udc9b"
SHOWN = r"\x1b]0;pwn\x07[red]a[/red]\x9b31m\u202eb\r\x9b"
SAY = """
import sys
import optimize.ui.console as console
from optimize.ui.process import open_standard_streams
from render.progress import Progress

open_standard_streams()
console.PATIENCE = 0.0
with console.reserved_stdout() as stream:
    stream.write(text)
    console.print_table(stream, text, [text], [[text]], below=text)
console.note(text)
print(f"tactilux: {text}", file=sys.stderr)
with console.ProgressBar(text) as bar:
    bar(Progress(1, 2, note=text))
    bar.note(text)
"""


def test_what_steers_is_written_out_and_the_rest_stays() -> None:
    assert printable(HOSTILE) == SHOWN
    assert printable("Grüße, 5 µm ± 1 °\n\tλ") == "Grüße, 5 µm ± 1 °\n\tλ"
    assert one_line("a\n\tb") == r"a\n\tb"


def test_a_table_shows_markup_and_escapes_as_text() -> None:
    stream = io.StringIO()
    print_table(stream, HOSTILE, [HOSTILE], [[HOSTILE]], below=HOSTILE)
    said = stream.getvalue()
    assert "\x1b" not in said
    assert said.count(r"\x1b]0;pwn\x07[red]a[/red]") == 4


@pytest.mark.parametrize("terminal", [False, True])
def test_no_stream_lets_a_stranger_steer(terminal: bool) -> None:
    command = [sys.executable, "-c", f"text = {HOSTILE!r}\n{SAY}"]
    if terminal:
        mine, theirs = pty.openpty()
        subprocess.run(command, cwd=ROOT, check=True, stdout=theirs, stderr=theirs, timeout=60)
        os.close(theirs)
        said = b""
        while True:
            try:
                said += os.read(mine, 65536)
            except OSError:  # its end
                break
        os.close(mine)
    else:
        done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=60)
        said = done.stdout + done.stderr
    text = said.decode("utf-8")
    assert text.count(r"\x1b]0;pwn") >= 6
    assert "\x1b]0;" not in text
    assert not set("\x07\x9b\u202e") & set(text)


def test_a_note_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    note("file\ntactilux: done")
    assert capsys.readouterr().err == "file\\ntactilux: done\n"
