"""The page on shots does what it says: its commands run and say what it shows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.test_tutorial import load_runner, words

PAGE = Path(__file__).parents[2] / "docs" / "several-shots.md"


@pytest.mark.slow
def test_its_commands_say_what_the_page_shows(tmp_path: Path) -> None:
    runner = load_runner()
    page = PAGE.read_text(encoding="utf-8")
    with runner.Shell(tmp_path, small=True) as shell:
        for block in runner.blocks(page):
            if not block.long:
                said = shell.run(block)
                assert block.output is not None
                expected, found = words(block.output), words(said)
                table = re.findall(r"│ (\w+)", block.output)
                assert {*table, "Design:", "Report:"} & {*expected} <= {*found}, block.body
    assert "shots = 2" in (tmp_path / "mine.toml").read_text()
