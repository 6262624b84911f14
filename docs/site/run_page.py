"""Run the commands of a page in their order, and write under each what it prints.

``python docs/site/run_page.py docs/tutorial.md`` makes the outputs and pictures of the page again;
a test runs the same commands with the small efforts that the page names in comments:

- ``<!-- small: --samples 400 -> --samples 8 -->`` before a block: what the test does instead;
- ``<!-- long -->``: minutes even so; validation runs it;
- ``<!-- exit 1 -->``: the last command ends with this code;
- ``<!-- second shell -->``: begins here and goes on until the page ends;
- ``<!-- picture: tutorial-sensor.svg = fingertip.svg -->``: a picture that the commands have made.

A ``diff`` block is an edit of the file that it names. What a block prints stands in a ``text``
block behind it.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

BLOCK = re.compile(
    r"(?P<notes>(?:<!-- [^\n]+ -->\n)*)```(?P<kind>sh|diff)\n(?P<body>.*?)\n```"
    r"(?:\n\n```text\n(?P<output>.*?)\n?```)?",
    re.DOTALL,
)
PICTURE = re.compile(r"<!-- picture: (\S+) = (\S+) -->")
NOTE = re.compile(r"<!-- (.+?) -->")
ROOT = Path(__file__).parents[2]
PATIENCE = 60.0  # seconds until a second shell speaks


@dataclass(frozen=True)
class Block:
    """One block of a page.

    Arguments:
        kind: ``sh`` or ``diff``.
        body: the commands, or the edit.
        output: what the page says that they print; None where it shows nothing.
        notes: the comments before it.
        span: where ``output`` stands in the page, end excluded.
    """

    kind: str
    body: str
    output: str | None
    notes: tuple[str, ...]
    span: tuple[int, int]

    @property
    def long(self) -> bool:
        """Whether it takes minutes even with little effort."""
        return "long" in self.notes

    @property
    def beside(self) -> bool:
        """Whether it goes on in a second shell."""
        return "second shell" in self.notes

    @property
    def code(self) -> int:
        """The exit code of its last command."""
        return next((int(note[5:]) for note in self.notes if note.startswith("exit ")), 0)

    @property
    def efforts(self) -> list[tuple[str, str]]:
        """What a test replaces, and by what."""
        found = [note.removeprefix("small: ") for note in self.notes if note.startswith("small: ")]
        pairs = [part.split(" -> ") for part in found]
        return [(old, new) for old, new in pairs]


def blocks(page: str) -> Iterator[Block]:
    """Yield the blocks of a page that do something."""
    for found in BLOCK.finditer(page):
        notes = tuple(NOTE.findall(found["notes"]))
        yield Block(found["kind"], found["body"], found["output"], notes, found.span("output"))


@dataclass
class Shell:
    """Runs blocks in a folder, with the program of this environment.

    Arguments:
        folder: where they run.
        small: whether to take the small efforts.
    """

    folder: Path
    small: bool = False
    beside: list[subprocess.Popen[str]] = field(default_factory=list)

    def __enter__(self) -> Shell:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the second shells, as Ctrl-C does."""
        for process in self.beside:
            os.killpg(process.pid, signal.SIGINT)
            process.wait(PATIENCE)
            assert process.stdout is not None
            process.stdout.close()

    def run(self, block: Block) -> str:
        """Return what a block prints on stdout.

        Raises:
            RuntimeError: a command ended with another code than the page says, or an edit does not
                fit its file.
        """
        if block.kind == "diff":
            self._edit(block.body)
            return ""
        body = block.body
        for old, new in block.efforts if self.small else []:
            if old not in body:
                raise RuntimeError(f"{old} is not in:\n{body}")
            body = body.replace(old, new)
        environment = os.environ | {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH")))),
            "COLUMNS": "100",
        }
        if block.beside:
            return self._begin(body, environment)
        done = subprocess.run(
            ["bash", "-c", f"set -e\n{body}"], cwd=self.folder, env=environment,
            capture_output=True, text=True,
        )  # fmt: skip
        if done.returncode != block.code:
            raise RuntimeError(f"{body}\nended with {done.returncode}:\n{done.stderr[-2000:]}")
        return "".join(f"{line.rstrip()}\n" for line in done.stdout.splitlines())

    def _begin(self, body: str, environment: dict[str, str]) -> str:
        process = subprocess.Popen(
            ["bash", "-c", body], cwd=self.folder, env=environment,
            stdout=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        self.beside.append(process)
        assert process.stdout is not None
        began = time.monotonic()
        said = process.stdout.readline()
        if not said or time.monotonic() - began > PATIENCE:
            raise RuntimeError(f"{body}\nsaid nothing")
        return said

    def _edit(self, body: str) -> None:
        head, *lines = body.splitlines()
        path = self.folder / head.removeprefix("--- ")
        text = path.read_text(encoding="utf-8")
        for hunk in "\n".join(lines).split("\n@@\n"):
            rows = hunk.splitlines()
            old = "\n".join(row[1:] for row in rows if not row.startswith("+"))
            new = "\n".join(row[1:] for row in rows if not row.startswith("-"))
            if text.count(old) != 1:
                raise RuntimeError(f"{head}: found {text.count(old)} times:\n{old}")
            text = text.replace(old, new)
        path.write_text(text, encoding="utf-8")


def pictures(page: str) -> list[tuple[str, str]]:
    """Return the pictures of a page: their names, and the files that its commands make of them."""
    return [(name, made) for name, made in PICTURE.findall(page)]


def main(path: Path) -> None:
    """Write outputs and pictures of a page."""
    page = path.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder, Shell(Path(folder)) as shell:
        outputs = []
        for block in blocks(page):
            if block.output is not None or not block.long:
                print(block.body, file=sys.stderr, flush=True)
                outputs.append((block, shell.run(block)))
        for name, made in pictures(page):
            shutil.copy(Path(folder) / made, path.parent / name)
    for block, output in reversed(outputs):
        if block.output is not None:
            page = page[: block.span[0]] + output.rstrip("\n") + page[block.span[1] :]
    path.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
