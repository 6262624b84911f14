"""A page as a reader meets it in Chromium: what sticks out, what is too small, what it asks for."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.image import imread

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SMALLEST = 11.0  # CSS pixels of text
# Width and height in CSS pixels, device pixels per CSS pixel, and whether a finger does the work.
SCREENS = {
    "desk": (1280, 900, 1, False),
    "phone": (390, 844, 3, True),
    "small phone": (320, 568, 2, True),
}
# Elements of the page that stick out, pictures that do not show, and text that is too small.
EXAMINE = """([smallest, width]) => {
    const name = e => e.tagName + (e.className ? '.' + e.className : '');
    const wide = [...document.querySelectorAll('body *')].filter(e =>
        e.getBoundingClientRect().right > width + 1 && !e.closest('.scroll'));
    const scrolled = [...document.querySelectorAll('.scroll')].filter(e =>
        e.scrollWidth > e.clientWidth + 1);
    const blank = [...document.images].filter(e =>
        !e.complete || !e.naturalWidth || e.getBoundingClientRect().width < 100 || !e.alt);
    const words = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    const small = [];
    while (words.nextNode()) {
        const e = words.currentNode.parentElement;
        // What is drawn as SVG counts in units of its own.
        const unit = e.getScreenCTM ? e.getScreenCTM().a : 1;
        if (words.currentNode.data.trim()
            && unit * parseFloat(getComputedStyle(e).fontSize) < smallest) small.push(e);
    }
    return {
        page: document.documentElement.scrollWidth - width,
        wide: wide.map(name), scrolled: scrolled.map(name), blank: blank.map(name),
        small: small.map(name), pictures: document.images.length,
    };
}"""


# Text whose contrast to what is behind it is below 4.5 (WCAG 2.2, 1.4.3), with its contrast.
PALE = """() => {
    const light = rgb => {
        const [r, g, b] = rgb.map(v => v / 255).map(
            v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    const parts = color => color.match(/[\\d.]+/g).map(Number);
    const behind = e => {
        for (; e; e = e.parentElement) {
            const [r, g, b, a] = parts(getComputedStyle(e).backgroundColor);
            if (a === undefined || a > 0.99) return [r, g, b];
        }
        return [255, 255, 255];
    };
    const words = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    const pale = [];
    while (words.nextNode()) {
        const e = words.currentNode.parentElement;
        if (!words.currentNode.data.trim() || e.closest('svg')) continue;
        const [a, b] = [light(parts(getComputedStyle(e).color)), light(behind(e))];
        const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
        if (contrast < 4.5) pale.push(e.tagName + ' ' + contrast.toFixed(1));
    }
    return pale;
}"""


@dataclass(frozen=True)
class Look:
    """What a reader gets to see."""

    page: int
    wide: list[str]
    scrolled: list[str]
    blank: list[str]
    small: list[str]
    pictures: int
    requests: list[str]
    complaints: list[str]
    shot: np.ndarray


def look(browser: Browser, path: Path, screen: str) -> Look:
    """Open a file as on one of the screens, without a network."""
    width, height, density, touch = SCREENS[screen]
    context = browser.new_context(
        viewport={"width": width, "height": height},
        device_scale_factor=density,
        is_mobile=touch,
        has_touch=touch,
        offline=True,
    )
    with context:
        page = context.new_page()
        requests: list[str] = []
        complaints: list[str] = []
        page.on("request", lambda request: requests.append(request.url))
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(path.as_uri())
        found = page.evaluate(EXAMINE, [SMALLEST, width])
        shot = imread(io.BytesIO(page.screenshot()))
    outside = [url for url in requests if not url.startswith("data:") and url != path.as_uri()]
    return Look(**found, requests=outside, complaints=complaints, shot=shot)


@contextmanager
def opened(browser: Browser, path: Path) -> Iterator[Page]:
    """Open a file on a desk, without a network; its scripts must not fail meanwhile."""
    with browser.new_context(viewport={"width": 1280, "height": 1100}, offline=True) as context:
        context.set_default_timeout(120_000)  # of a busy machine
        page = context.new_page()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(path.as_uri())
        yield page
        assert not errors


def camera_picture(
    play: Page, touch: int, bend: int, center: Sequence[float], size: tuple[int, int]
) -> np.ndarray:
    """Return the camera's picture on a page to play with, in 8 bits; ``bend`` is its number.

    A ``touch`` that the page does not know is none.
    """
    url = play.evaluate("(a) => tactilux.picture(...a)", [touch, bend, list(center), *size])
    return np.asarray(255.0 * imread(io.BytesIO(base64.b64decode(url.partition(",")[2])))[..., :3])


def pale_text(browser: Browser, path: Path, scheme: str) -> tuple[list[str], str]:
    """Return text that is hard to read under a color scheme, and the color of the page."""
    with browser.new_context(color_scheme=scheme, offline=True) as context:
        page = context.new_page()
        page.goto(path.as_uri())
        page.evaluate("document.querySelectorAll('details').forEach(e => e.open = true)")
        paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
        return page.evaluate(PALE), paper
