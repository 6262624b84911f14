"""The page to play with allows the colorings of parts that the searches allow."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from optimize.design import limits_of
from optimize.placement import searched_scene
from optimize.play import PlayPage, write_play
from optimize.scoring import open_model
from render.scene import load_scene, scene_text
from tests.optimize.browser import opened

if TYPE_CHECKING:
    from playwright.sync_api import Browser

SEARCH = """
[search]
parts = ["red-0603", "blue-0603", "ws2812b-2020"]
current = { value = 45.0, unit = "mA", source = "the board" }
"""


@pytest.mark.slow
def test_the_page_allows_what_searches_allow(chromium: Browser, tmp_path: Path) -> None:
    drawn = scene_text("digit").replace("columns = 3\nrows = 4", "columns = 2\nrows = 2")
    (tmp_path / "small.toml").write_text(drawn + SEARCH)
    scene = searched_scene(load_scene(tmp_path / "small.toml"), place=False, lamps=3)
    limits = limits_of(scene)
    rng = np.random.default_rng(5)
    colors = np.full((400, scene.lamp_count), -1)
    for row in colors:
        for lamp in rng.choice(np.arange(3, scene.lamp_count), rng.integers(1, 4), replace=False):
            row[lamp] = rng.choice(np.flatnonzero(limits.allowed[lamp, :-1]))
    fits = limits.fits(colors)
    assert 50 < fits.sum() < 350
    path = tmp_path / "page.html"
    write_play(path, PlayPage(scene, open_model(scene, coarse=True), objective="score"))
    with opened(chromium, path) as page:
        said = page.evaluate(f"{colors.tolist()}.map(tactilux.allows)")
    assert said == fits.tolist()
