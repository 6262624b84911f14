"""The page of parts is what the library holds, and the command lists the same."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from render.scene.catalog.led import entries_of, shipped_leds
from render.scene.catalog.listing import HEADINGS, page_of, rows_of

PAGE = Path(__file__).parents[4] / "docs" / "parts.md"
Run = Callable[..., Any]


def test_the_page_in_the_documents_is_that_of_the_library() -> None:
    assert PAGE.read_text(encoding="utf-8") == page_of(shipped_leds())


def test_every_entry_has_a_row() -> None:
    rows = rows_of(shipped_leds())
    names = [entry.name for led in shipped_leds().values() for entry in entries_of(led)]
    assert [row[0] for row in rows] == names
    assert {len(row) for row in rows} == {len(HEADINGS)}


def test_the_command_lists_them_and_writes_the_page(tactilux: Run, tmp_path: Path) -> None:
    page = tmp_path / "parts.md"
    said = tactilux("parts", "--json", "--out", str(page))
    assert said.code == 0
    assert page.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")
    listed = {one["entry"]: one for one in json.loads(said.out)["parts"]}
    assert listed["ws2812b-red"]["pwm_hz"] == 400.0
    assert listed["ws2812b-red"]["mcd"] == 405.0
    # 405 mcd of a Lambertian beam are 1.27 lm, of some 244 lm/W.
    assert listed["ws2812b-red"]["milliwatts"] == pytest.approx(5.2, rel=0.02)
