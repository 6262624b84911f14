"""Reports as a reader meets them in Chromium: on a desk, on a phone and on paper."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from optimize.design import Design, ScoreSettings, baseline_design
from optimize.exploration import Exploration, rate
from optimize.report import write_exploration, write_optimization
from optimize.scoring import search_table
from optimize.search import AlternatingResult, SearchStep
from optimize.verification import DesignRenders, FinalistEvaluation, Optimization, judge_of
from render.scene import Scene, standalone
from surrogate.runtime import Checker
from tests.optimize.browser import SCREENS, look, pale_text

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Browser

MODEL = Path(__file__).parents[2] / "models" / "finger20"


def printed(browser: Browser, path: Path) -> list[str]:
    """Print a file on A4 and return the text of each page."""
    from pypdf import PdfReader

    with browser.new_context(offline=True) as context:
        page = context.new_page()
        page.goto(path.as_uri())
        pdf = PdfReader(io.BytesIO(page.pdf(format="A4", prefer_css_page_size=True)))
    return [sheet.extract_text() for sheet in pdf.pages]


@pytest.fixture(scope="module")
def explore_report(
    finger20: Scene, finger20_checker: Checker, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    rng = np.random.default_rng(5)
    base = baseline_design(finger20)
    mixed = Design.of_colors(base.phi, np.arange(20) % 3)
    turned = Design(rng.uniform(0.5, 2.6, 20), mixed.power)
    texts = [("baseline", "Baseline", ""), ("colors", "Colors", "the color search")]
    texts += [("optimized", "Optimized", "the fiber directions")]
    stages = tuple(
        rate(finger20_checker, finger20, *text, design)
        for text, design in zip(texts, (base, mixed, turned), strict=True)
    )
    names = [(0, "start"), (1, "quick"), (1, "free")]
    steps = tuple(
        SearchStep(stage.design, stage.rating.score, number, name, 100 * i, 2.0 * i)
        for i, ((number, name), stage) in enumerate(zip(names, stages, strict=True))
    )
    search = AlternatingResult(turned, stages[-1].rating.score, steps, True)
    found = Exploration(finger20, finger20_checker, stages, search, 0, 4.0)
    target = tmp_path_factory.mktemp("explore") / "run"
    write_exploration(found, standalone("finger20"), target, lambda: 4.0)
    return target / "report.html"


@pytest.fixture(scope="module")
def optimize_report(
    finger20: Scene, finger20_checker: Checker, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Return the report of finalists whose renders are the surrogate's table with noise."""
    table, rng = search_table(finger20_checker), np.random.default_rng(8)
    base = baseline_design(finger20)
    designs = (base, Design.of_colors(base.phi, np.arange(20) // 4 % 3))
    light = np.stack([table.at(design.phi) for design in designs])
    noisy = light * (1.0 + 0.01 * rng.standard_normal((4, *light.shape)))
    renders = DesignRenders(designs, noisy, noisy.mean(axis=-1), noisy.std(axis=0), 60.0)
    settings = ScoreSettings(finger20_checker.exposure, finger20_checker.lam)
    finalists = FinalistEvaluation(
        ("baseline", "thesis"), renders, judge_of("sensor", finger20, settings)
    )
    outcome = Optimization(None, None, {"thesis": 60.0}, finalists, None)
    target = tmp_path_factory.mktemp("optimize") / "run"
    write_optimization(finger20, outcome, finger20_checker, standalone("finger20"), target)
    return target / "report.html"


@pytest.mark.parametrize("screen", SCREENS)
def test_the_report_of_an_optimization_fits_the_screen_and_shows_its_pictures(
    chromium: Browser, optimize_report: Path, screen: str
) -> None:
    seen = look(chromium, optimize_report, screen)
    assert seen.page <= 0
    assert seen.wide == []
    assert screen == "small phone" or seen.scrolled == []
    assert seen.small == []
    assert screen == "small phone" or seen.blank == []
    assert seen.pictures == 2 * 3 + 2
    assert seen.requests == []
    assert seen.complaints == []


@pytest.fixture(params=["night_report", "explore_report"])
def report(request: pytest.FixtureRequest) -> Path:
    path: Path = request.getfixturevalue(request.param)
    return path


@pytest.mark.parametrize("screen", SCREENS)
def test_a_report_fits_the_screen(chromium: Browser, report: Path, screen: str) -> None:
    seen = look(chromium, report, screen)
    assert seen.page <= 0
    assert seen.wide == []
    assert screen == "small phone" or seen.scrolled == []
    assert seen.small == []


@pytest.mark.parametrize("screen", ["desk", "phone"])
def test_every_picture_of_a_report_shows(chromium: Browser, report: Path, screen: str) -> None:
    seen = look(chromium, report, screen)
    assert seen.blank == []
    assert seen.pictures >= 3 * 3 + 6 + 2
    # Gray levels of smooth letters, at least: the page is not blank.
    assert len(np.unique(seen.shot)) > 50


def test_a_report_asks_for_nothing_but_itself(chromium: Browser, report: Path) -> None:
    seen = look(chromium, report, "desk")
    assert seen.requests == []
    assert seen.complaints == []


@pytest.mark.parametrize(
    ("scheme", "paper"), [("light", "rgb(255, 255, 255)"), ("dark", "rgb(22, 24, 28)")]
)
def test_a_report_follows_the_color_scheme_and_its_text_stands_out(
    chromium: Browser, report: Path, scheme: str, paper: str
) -> None:
    assert pale_text(chromium, report, scheme) == ([], paper)


def test_pale_text_is_noticed(chromium: Browser, tmp_path: Path) -> None:
    path = tmp_path / "pale.html"
    path.write_text('<body style="background:#222"><p style="color:#444">faint</p>')
    pale, paper = pale_text(chromium, path, "light")
    assert pale == ["P 1.6"]
    assert paper == "rgb(34, 34, 34)"


def test_a_report_ends_with_what_to_do_next(chromium: Browser, report: Path) -> None:
    with chromium.new_context(offline=True) as context:
        page = context.new_page()
        page.goto(report.as_uri())
        headings = page.locator("h2").all_inner_texts()
        commands = page.locator("#next code").all_inner_texts()
    assert headings.index("Next") > headings.index("How far to trust this")
    assert set(headings[headings.index("Next") + 1 :]) <= {"Origin", "More workers"}
    assert any(command.startswith("tactilux wiring ") for command in commands)
    assert any(command.startswith("tactilux hw set ") for command in commands)
    unrendered = report.parent.name == "run" and "verify" in commands[0]
    assert unrendered or commands[0].startswith("tactilux sensitivity ")


def test_the_wiring_sheet_prints_on_a_page_of_its_own(chromium: Browser, report: Path) -> None:
    pages = printed(chromium, report)
    (number,) = [i for i, text in enumerate(pages) if "Wiring sheet" in text]
    sheet = pages[number]
    assert sheet.lstrip().startswith("Wiring sheet")
    place = r"(?:left|tip|right)\s+\S+\s+\S+"
    feed = r"(?:red|green|blue)\s+20\s+(\d+)\s+(\d+)"
    rows = re.findall(rf"^(\d+)\s+{place}\s+{feed}\s+\d+\.\d°", sheet, re.MULTILINE)
    assert [int(fiber) for fiber, _, _ in rows] == list(range(20))
    assert [int(led) for _, led, _ in rows] == list(range(20))
    assert [int(channel) // 3 for _, _, channel in rows] == list(range(20))
    assert "68471ad4c129ea4d" in sheet
    assert "Searches keep to this" in sheet
    assert 0 < number < len(pages) - 1
    assert len(pages) < 9


def test_what_sticks_out_breaks_or_is_fetched_is_noticed(chromium: Browser, tmp_path: Path) -> None:
    path = tmp_path / "bad.html"
    path.write_text(
        '<meta name="viewport" content="width=device-width"><p style="width:900px">wide</p>'
        '<small style="font-size:8px">small</small><img src="https://example.com/a.png" alt="a">'
    )
    seen = look(chromium, path, "phone")
    assert seen.page > 0
    assert seen.wide == ["P"]
    assert seen.small == ["SMALL"]
    assert seen.blank == ["IMG"]
    assert seen.requests == ["https://example.com/a.png"]
    assert seen.complaints
