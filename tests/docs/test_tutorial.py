"""The tutorial does what it says: its commands run, and print and draw what the page shows."""

from __future__ import annotations

import re
import sys
from collections import Counter
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorial.md"
SCORE_TOLERANCE = 10.0
"""Counts: the page is written anew when a level changes by more."""
DEGREES_TOLERANCE = 0.2
"""Degrees of the readers, likewise."""


def load_runner() -> ModuleType:
    path = ROOT / "docs" / "site" / "run_page.py"
    spec = spec_from_file_location("run_page", path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def runner() -> ModuleType:
    return load_runner()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tutorial")


@pytest.fixture(scope="module")
def played(runner: ModuleType, folder: Path) -> list[tuple[Any, str]]:
    """Run the page's blocks in their order with small efforts: block and output."""
    page = PAGE.read_text(encoding="utf-8")
    with runner.Shell(folder, small=True) as shell:
        return [(block, shell.run(block)) for block in runner.blocks(page) if not block.long]


def words(text: str) -> Counter[str]:
    """Return the words that do not depend on numbers; notes come and go with them."""
    lines = [line for line in text.splitlines() if not line.startswith("Note:")]
    return Counter(re.findall(r"[A-Za-z]{3,}", re.sub(r"\b[0-9a-f]{16}\b", "", "\n".join(lines))))


def test_every_command_of_the_page_is_one_that_runs(runner: ModuleType) -> None:
    page = PAGE.read_text(encoding="utf-8")
    found = [block.body for block in runner.blocks(page)]
    shown = re.findall(r"```(?:sh|diff)\n(.*?)\n```", page, re.DOTALL)
    assert found == shown
    commands = [body for body in found if body.startswith(("tactilux", "cat"))]
    assert len(commands) >= 11
    others = re.findall(r"^```(\w*)$", page, re.MULTILINE)
    assert set(others) == {"", "sh", "diff", "text"}


def test_what_the_page_shows_is_what_its_commands_say(played: list[tuple[Any, str]]) -> None:
    compared = 0
    for block, output in played:
        if block.output is not None and not block.efforts:
            assert words(output) == words(block.output), block.body
            compared += 1
    assert compared >= 8


def test_its_scores_are_those_of_today(played: list[tuple[Any, str]]) -> None:
    row = r"│ (\w[\w ]*?) +│ +(\d+\.\d+)° │ +(\d+\.\d+)° │ +(\d+\.\d) │"
    tables = 0
    for block, output in played:
        shown, fresh = re.findall(row, block.output or ""), re.findall(row, output)
        if shown and not block.efforts:
            assert [name for name, *_ in fresh] == [name for name, *_ in shown]
            for (_, *now), (_, *then) in zip(fresh, shown, strict=True):
                off = [abs(float(one) - float(other)) for one, other in zip(now, then, strict=True)]
                assert max(off[:2]) < DEGREES_TOLERANCE
                assert off[2] < SCORE_TOLERANCE
            tables += 1
    assert tables == 2


def test_the_check_names_the_fiber_that_the_rig_has_lost(played: list[tuple[Any, str]]) -> None:
    said = [output for block, output in played if "fiber-4-dead --rig" in block.body]
    assert len(said) == 1
    assert said[0].startswith("Fiber 4 is dead")


def test_little_effort_renders_too(played: list[tuple[Any, str]]) -> None:
    (said,) = [output for block, output in played if "tactilux verify" in block.body]
    assert "reference (bidirectional, MIS)" in said
    assert "Difference" in said


@pytest.mark.usefixtures("played")
def test_every_picture_of_the_page_is_made_by_its_commands(
    runner: ModuleType, folder: Path
) -> None:
    page = PAGE.read_text(encoding="utf-8")
    made = dict(runner.pictures(page))
    assert set(re.findall(r"!\[[^\]]*\]\((\S+)\)", page)) == set(made)
    for name, path in made.items():
        kept, fresh = (PAGE.parent / name).read_bytes(), (folder / path).read_bytes()
        assert kept[:4] == fresh[:4]
        assert len(kept) < 60_000
        assert 0.5 < len(kept) / len(fresh) < 2.0


def test_an_edit_that_does_not_fit_its_file_is_refused(runner: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("x = 1\ny = 2\n")
    (block,) = runner.blocks("```diff\n--- a.toml\n-z = 3\n+z = 4\n```\n")
    with pytest.raises(RuntimeError, match="found 0 times"):
        runner.Shell(tmp_path).run(block)


def test_a_command_that_ends_otherwise_than_the_page_says_is_refused(
    runner: ModuleType, tmp_path: Path
) -> None:
    (block,) = runner.blocks("<!-- exit 1 -->\n```sh\ntrue\n```\n")
    with pytest.raises(RuntimeError, match="ended with 0"):
        runner.Shell(tmp_path).run(block)
