"""Pictures of pages are small, are shown where a reader begins, and show what the page shows."""

from __future__ import annotations

import importlib.util
import io
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.image import imread

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def screenshots() -> ModuleType:
    spec = importlib.util.spec_from_file_location("screenshots", ROOT / "docs/site/screenshots.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_readme_shows_them_and_they_are_small(screenshots: ModuleType) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for name, (_, _, height) in screenshots.PAGES.items():
        path = ROOT / "docs" / f"{name}.png"
        assert f'src="docs/{name}.png"' in text
        assert path.stat().st_size < screenshots.MAX_BYTES
        shape = imread(path).shape
        rows = round(height * screenshots.SHOWN / screenshots.WIDTH)
        assert shape[:2] == (rows, screenshots.SHOWN)


def test_a_picture_begins_where_it_is_told_in_the_colors_of_the_page(
    screenshots: ModuleType, chromium: Browser, tmp_path: Path
) -> None:
    page = tmp_path / "page.html"
    page.write_text(
        '<body style="margin:0;background:rgb(200,30,30)"><div style="height:2000px"></div>'
        '<h2 style="margin:0;height:24px"></h2>'
        '<div style="background:rgb(20,120,220);height:2000px">'
    )
    picture = imread(io.BytesIO(screenshots.screenshot(chromium, page, "h2", 400)))
    assert picture.shape[:2] == (300, 960)
    rows = np.round(255 * picture[:, 480, :3]).astype(int)
    # 24 pixels before the heading and 24 of its own, three quarters of the size.
    np.testing.assert_allclose(rows[:34], [[200, 30, 30]] * 34, atol=2)
    np.testing.assert_allclose(rows[38:], [[20, 120, 220]] * 262, atol=2)
