"""The page on thickness does what it says: its command and its Python run, and its keys exist."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from optimize.dimensions import Variants, dimension_of
from render.errors import SceneError
from render.scene import load_scene, shipped_scenes
from tests.docs.test_tutorial import load_runner

PAGE = Path(__file__).parents[2] / "docs" / "how-thick-should-the-gel-be.md"
TEXT = PAGE.read_text(encoding="utf-8")


def test_every_key_of_the_table_is_one_of_a_shipped_scene() -> None:
    asked = re.findall(r"`([a-z_.]+=[0-9.:,]+)`", TEXT)
    assert len(asked) > 6
    for text in asked:
        fits = 0
        for name in shipped_scenes():
            scene = load_scene(name)
            try:
                follow = text.startswith("pad.thickness")
                Variants(scene, [dimension_of(scene, text)], lamps_follow=follow)
                fits += 1
            except SceneError:
                pass
        assert fits, text


@pytest.mark.slow
def test_the_command_prints_what_the_page_shows_and_draws_its_picture(tmp_path: Path) -> None:
    runner = load_runner()
    (block,) = runner.blocks(TEXT)
    with runner.Shell(tmp_path, small=True) as shell:
        said = shell.run(block)
    assert block.output
    legends = [text[text.index("Readers: ") : text.index("all errors.")] for text in
               (said, block.output)]  # fmt: skip
    assert legends[0] == legends[1]
    files = [text[text.index("Scene: ") :].split() for text in (said, block.output)]
    assert files[0] == files[1]
    for heading in ("pad.thickness, mm", "sensor reader", "place reader", "change, sensor"):
        assert heading in said
        assert heading in block.output
    ((name, path),) = runner.pictures(TEXT)
    for picture in (PAGE.parent / name, tmp_path / path):
        assert picture.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
def test_the_python_of_the_page_runs(tmp_path: Path) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    assert done.stdout.count("\n") == 1
    assert "sensor reader" in done.stdout
    assert (tmp_path / "thickness.png").is_file()
