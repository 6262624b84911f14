"""The page to play with speaks of a scene's own LEDs, whatever channels its camera has."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from optimize.design import Design, limits_of, load_design
from optimize.play import PlayPage, write_play
from optimize.scoring import TableScorer, open_model, search_table
from optimize.search.colors import quick_colors
from render.scene import Scene
from surrogate.runtime import Checker
from tests.colored_scenes import AMBER, WHITE, mono, scene_with
from tests.optimize.browser import opened

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["white and amber", "mono"])
def sensor(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Scene, Checker]:
    folder = tmp_path_factory.mktemp("scene")
    if request.param == "mono":
        scene = mono(folder, small=True)
    else:
        scene = scene_with(folder, WHITE + AMBER, ("white", "amber", "white"), small=True)
    return scene, open_model(scene, coarse=True)


@pytest.fixture
def play(chromium: Browser, sensor: tuple[Scene, Checker], tmp_path: Path) -> Iterator[Page]:
    path = tmp_path / "page.html"
    write_play(path, PlayPage(*sensor, objective="score"))
    with opened(chromium, path) as page:
        yield page


def rated(page: Page, design: Design) -> float:
    degrees, drive = np.degrees(design.phi).tolist(), design.drive.tolist()
    said: dict[str, Any] = page.evaluate(f"tactilux.rate({degrees}, {drive})")
    return float(said["score"])


def test_scores_are_those_of_the_model(sensor: tuple[Scene, Checker], play: Page) -> None:
    scene, checker = sensor
    rng, palette = np.random.default_rng(3), scene.palette
    for _ in range(40):
        drive = rng.uniform(0.0, 0.5, (scene.lamp_count, len(palette.names)))
        design = Design(rng.uniform(0.0, np.pi, scene.lamp_count), drive, palette)
        bends = np.array(scene.bending.angles)
        said = checker.run(design.phi[None], design.power[None], bends)["score"]
        assert rated(play, design) == pytest.approx(float(said[0]), abs=0.05)


def test_keys_choose_the_scenes_leds_and_the_saved_file_has_them(
    sensor: tuple[Scene, Checker], play: Page, tmp_path: Path
) -> None:
    scene, _ = sensor
    names = scene.palette.names
    lamp = play.locator(".lamp").first
    lamp.focus()
    play.keyboard.press(names[1][0])
    with play.expect_download() as download:
        play.get_by_role("button", name="Save design.json").click()
    path = tmp_path / "design.json"
    download.value.save_as(path)
    saved = load_design(path, scene)
    assert saved.palette == scene.palette
    assert saved.color_names[0] == names[1]
    lamp.focus()
    play.keyboard.press("o")
    assert play.evaluate("tactilux.design()")["colors"][0] == "off"
    play.keyboard.press("Enter")
    assert play.evaluate("tactilux.design()")["colors"][0] == names[0]


def test_uphill_ends_where_no_other_leds_of_two_lamps_are_better(
    sensor: tuple[Scene, Checker], play: Page
) -> None:
    scene, checker = sensor
    play.get_by_role("button", name="Push uphill").click()
    for _ in range(600):
        if not play.evaluate("tactilux.climbing()"):
            break
        play.wait_for_timeout(200)
    found = play.evaluate("tactilux.design()")
    design = Design(np.radians(found["angles_deg"]), np.array(found["power"]), scene.palette)
    scorer = TableScorer(search_table(checker), limits=limits_of(scene))
    score = scorer.score(design.phi, design.power)
    assert found["score"]["value"] == pytest.approx(score, abs=0.5)
    again = quick_colors(scorer, design.phi, starts=[design.colors], restarts=0)
    assert again.score < score + 0.1
