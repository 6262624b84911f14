"""What documents say of places loads, runs, and says what the page shows."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from optimize.placement import candidates_of, searched_scene
from render.scene import load_scene, scene_text
from tests.docs.test_tutorial import load_runner, words

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "where-do-i-put-my-leds.md"


@pytest.mark.parametrize(
    ("page", "places"), [(PAGE, 10), (DOCS / "scenes.md", 9 * 2 + 2)], ids=["page", "scenes"]
)
def test_the_section_that_a_page_shows_is_taken(page: Path, places: int, tmp_path: Path) -> None:
    (section,) = re.findall(r"```toml\n(\[search\].*?)```", page.read_text(), re.DOTALL)
    path = tmp_path / "mine.toml"
    path.write_text(scene_text("digit") + section)
    assert searched_scene(load_scene(path)).lamp_count == 3 + places


def test_rails_beyond_edges_that_a_page_shows_are_taken(tmp_path: Path) -> None:
    page = (DOCS / "scenes.md").read_text()
    (section,) = re.findall(r"```toml\n(\[\[search.places\]\].*?)```", page, re.DOTALL)
    path = tmp_path / "mine.toml"
    path.write_text(scene_text("digit") + section)
    found = candidates_of(load_scene(path))
    kinds = [candidate.rail.kind for candidate in found]
    assert set(kinds) == {"ring", "board", "list"}
    assert kinds.count("list") == 2
    assert all(np.hypot(*one.position[:2]) >= 4.0 for one in found)


@pytest.mark.slow
def test_its_commands_say_what_the_page_shows(tmp_path: Path) -> None:
    runner = load_runner()
    page = PAGE.read_text(encoding="utf-8")
    with runner.Shell(tmp_path, small=True) as shell:
        for block in runner.blocks(page):
            if not block.long:
                said = shell.run(block)
                assert block.output is not None
                level = {"surrogate", "converged", "photon", "noise", "color", "the", "preview"}
                expected, found = words(block.output), words(said)
                assert set(expected) - level <= set(found) | level, block.body
    for target, made in re.findall(r"<!-- picture: (\S+) = (\S+) -->", page):
        assert (DOCS / target).is_file()
        assert (tmp_path / made).is_file()
    shutil.rmtree(tmp_path / "runs")
