"""What commands and reports say is next works on a scene that `tactilux new` wrote."""

from __future__ import annotations

import html
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow

Run = Callable[..., Any]
SENSOR = ("--lamp", "led", "--diffuser", 0, "--width", 8, "--length", 8, "--left", 2, "--tip", 1,
          "--right", 2)  # fmt: skip
EFFORTS = {
    "verify": ["--samples", "4", "--seeds", "2"],
    "train": ["--samples", "2", "--coarse"],
}
"""What makes a command cheap."""
REFUSED = {"hw": "no serial port|--port", "check": "SWEEP"}
"""What a command may miss here: a board, and photographs of a rig."""


def next_steps(page: Path) -> list[list[str]]:
    """Return the commands of a page's last section, as a shell reads them."""
    section = page.read_text().partition('<section id="next">')[2]
    found = re.findall(r"<code>(tactilux .*?)</code>", section)
    return [shlex.split(html.unescape(command)) for command in found]


@pytest.fixture
def explored(tactilux: Run) -> Path:
    """Explore a new scene whose file is not called like it; return the report."""
    assert tactilux("new", "mine", "--out", "rev 7.toml", *SENSOR).code == 0
    said = tactilux("explore", "rev 7.toml", "--coarse")
    assert said.code == 0, said.err
    return Path(re.findall(r"^Report: (.+)$", said.out, re.MULTILINE)[0])


def test_new_says_a_command_that_explores_its_file(tactilux: Run) -> None:
    said = tactilux("new", "mine", "--out", "rev 7.toml", *SENSOR)
    (command,) = re.findall(r"go on with (tactilux .+)$", said.out, re.MULTILINE)
    (listing,) = re.findall(r"(tactilux describe .+) lists them", said.out)
    assert shlex.split(command) == ["tactilux", "explore", "rev 7.toml"]
    assert tactilux(*shlex.split(listing)[1:]).code == 0


def test_every_step_of_a_report_works(tactilux: Run, explored: Path) -> None:
    steps = next_steps(explored)
    assert [step[1] for step in steps] == [
        "verify",
        "train",
        "reconstruct",
        "sensitivity",
        "wiring",
        "hw",
        "check",
    ]
    for _, name, *rest in steps:
        done = tactilux(name, *rest, *EFFORTS.get(name, []))
        if name in REFUSED:
            assert (done.code, done.out) == (2, "")
            assert re.search(REFUSED[name], done.err), done.err
        else:
            assert done.code == 0, (name, rest, done.err)


def test_steps_of_a_comparison_and_of_a_list_of_runs_work(tactilux: Run, explored: Path) -> None:
    run = explored.parent
    assert tactilux("compare", run, run / "baseline.json", "--out", "both.html").code == 0
    assert tactilux("runs", "--out", "index.html").code == 0
    for page, names in (("both.html", ["compare"]), ("index.html", ["verify", "runs"])):
        steps = next_steps(Path(page))
        assert [step[1] for step in steps] == names
        for _, name, *rest in steps:
            small = ["4" if word == "200" else word for word in rest]
            done = tactilux(name, *small, *EFFORTS.get(name, []))
            assert done.code == 0, (name, rest, done.err)
