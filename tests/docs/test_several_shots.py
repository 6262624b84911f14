"""The page on shots does what it says: its commands run and say what it shows."""

from __future__ import annotations

import json
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
            said = shell.run(block)
            if block.output is not None:
                rows = re.findall(r"│ (\w+) ", block.output)
                assert {*rows} <= {*words(said)}, block.body
    gray = tmp_path / "runs" / "gray-explore" / "design.json"
    colors = json.loads(gray.read_text())["colors"]
    assert sorted(colors) == ["white@1", "white@2", "white@3"]
    assert "shots = 2" in (tmp_path / "mine.toml").read_text()
