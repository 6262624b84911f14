"""What the page to play with costs a browser with software rendering, against its bounds.

Script time is the processor time of the page's main thread, so that other programs do not count.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from optimize.design import baseline_design
from optimize.play import MAX_BYTES, PlayPage, write_play
from render.scene import load_scene
from surrogate.runtime import Checker

if TYPE_CHECKING:
    from playwright.sync_api import CDPSession, Page

MODEL = Path(__file__).parents[2] / "models" / "finger20"
FRAME, OPENING = 0.016, 1.0
"""Bounds in seconds: script per frame at the 95th percentile while a lamp is dragged; opening."""
MOVES = 60


def script_seconds(session: CDPSession) -> float:
    """Return the processor time that the page's scripts have taken so far."""
    metrics = session.send("Performance.getMetrics")["metrics"]
    return float(next(entry["value"] for entry in metrics if entry["name"] == "ScriptDuration"))


def dragged(page: Page, session: CDPSession) -> np.ndarray:
    """Return the script time of every frame while a beam is dragged to and fro."""
    box = page.locator(".lamp .tip").nth(3).bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    taken = []
    for move in range(MOVES):
        before = script_seconds(session)
        page.mouse.move(x, y + 30 * np.sin(move / 9))
        page.evaluate("new Promise((done) => requestAnimationFrame(() => setTimeout(done)))")
        taken.append(script_seconds(session) - before)
    page.mouse.up()
    return np.array(taken)


def test_the_page_opens_and_follows_a_dragged_lamp_in_time(tmp_path: Path) -> None:
    from playwright.sync_api import sync_playwright

    scene, path = load_scene("finger20"), tmp_path / "page.html"
    checker = Checker.load(MODEL, scene.hash)
    write_play(path, PlayPage(scene, checker, optimum=baseline_design(scene)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        page = browser.new_context(viewport={"width": 1280, "height": 1100}).new_page()
        page.set_default_timeout(300_000)
        session = page.context.new_cdp_session(page)
        session.send("Performance.enable", {"timeDomain": "threadTicks"})
        page.goto(path.as_uri())
        page.evaluate("new Promise((done) => requestAnimationFrame(() => setTimeout(done)))")
        metrics = session.send("Performance.getMetrics")["metrics"]
        opening = next(entry["value"] for entry in metrics if entry["name"] == "TaskDuration")
        frames = dragged(page, session)
        browser.close()
    low, high = np.percentile(frames, [50, 95])
    print(
        f"\npage of {path.stat().st_size / 1e6:.2f} MB (bound {MAX_BYTES / 1e6:g}): opens in "
        f"{opening:.2f} s of its thread; a frame of a drag takes {1e3 * low:.1f} ms of script, "
        f"at the 95th percentile {1e3 * high:.1f} ms, {high / FRAME:.2f} of the bound"
    )
    assert high < FRAME
    assert opening < OPENING
