"""Pictures of the pages that tactilux makes, as headless Chromium shows them.

``python docs/site/screenshots.py RUN`` takes them of a folder that ``tactilux explore finger20``
wrote: ``docs/play.png``, the page to play with, and ``docs/report.png``, what the report tells of
every design. Where it must be, colors are reduced to a palette: a picture is below `MAX_BYTES`.
"""

from __future__ import annotations

import io
import shutil
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, sync_playwright

DOCS = Path(__file__).parents[1]
WIDTH, SHOWN = 1280, 960
"""CSS pixels of the window, and pixels of the picture."""
PAGES = {"play": ("play.html", "h1", 960), "report": ("report.html", "h2:has(+ .stage)", 1010)}
"""What is shown: the file, where the picture begins, and how many CSS pixels it is high."""
MAX_BYTES = 150_000
SETTLED = 1500
"""Milliseconds after which a page has drawn all that moves into place."""


def screenshot(browser: Browser, page: Path, begin: str, height: int) -> bytes:
    """Return ``height`` CSS pixels of ``page`` from the element ``begin`` on, as PNG.

    A page to play with shows its optimum.
    """
    with browser.new_context(
        viewport={"width": WIDTH, "height": height}, color_scheme="light", offline=True
    ) as context:
        tab = context.new_page()
        tab.goto(page.resolve().as_uri())
        for optimum in tab.get_by_label("Optimum").all():
            optimum.check()
        tab.locator(begin).first.evaluate("e => window.scrollTo(0, e.offsetTop - 24)")
        tab.wait_for_timeout(SETTLED)
        shot = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
    small = shot.resize((SHOWN, round(height * SHOWN / WIDTH)), Image.Resampling.LANCZOS)
    for colors in (0, 256, 128, 64):
        stream = io.BytesIO()
        picture = small
        if colors:  # in two steps, because the first one dithers nothing
            palette = small.quantize(colors, Image.Quantize.FASTOCTREE)
            picture = small.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)
        picture.save(stream, "png", optimize=True)
        if stream.tell() < MAX_BYTES:
            break
    return stream.getvalue()


def main(run: Path) -> None:
    """Write both pictures."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        for name, shown in PAGES.items():
            path = DOCS / f"{name}.png"
            path.write_bytes(screenshot(browser, run / shown[0], *shown[1:]))
            print(path)
        browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
