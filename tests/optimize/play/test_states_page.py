"""The page to play with of a skin with states: the state is chosen, drawn and scored."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from optimize.design import baseline_design
from optimize.play import PlayPage, write_play
from optimize.report import encode_srgb
from render.geometry import SkinChart, ball, in_state
from render.preview import Preview
from render.scene import Scene
from surrogate.preview_model import preview_checker
from surrogate.runtime import Checker
from tests.optimize.browser import camera_picture, opened
from tests.oracles.soft_domes import scene_text_of, write_files, written

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Browser, LocatorAssertions, Page

SIZE, CENTER = (49, 65), (4.0, 5.0)
NAMES = ["rest", "low", "twisted"]


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Checker]:
    folder = tmp_path_factory.mktemp("dome")
    write_files(folder, steps=16)
    scene = written(
        folder, scene_text_of("low", "twisted").replace("turns = false", "turns = true")
    )
    return scene, preview_checker(scene, coarse=True)


@pytest.fixture(scope="module")
def play(
    chromium: Browser, model: tuple[Scene, Checker], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Page]:
    path, (scene, checker) = tmp_path_factory.mktemp("play") / "page.html", model
    write_play(path, PlayPage(scene, checker, optimum=baseline_design(scene)))
    with opened(chromium, path) as page:
        yield page


def spoken(play: Page) -> LocatorAssertions:
    """Return what is said of the map, waited for: the page speaks 300 ms after the last change."""
    from playwright.sync_api import expect

    expect.set_options(timeout=60_000)
    return expect(play.locator("#heat"))


def test_a_reader_chooses_the_state_by_its_name(play: Page, model: tuple[Scene, Checker]) -> None:
    scene, checker = model
    base = baseline_design(scene)
    said = checker.run(base.phi[None], base.power[None], np.array(scene.state_axis))["metric"][0]
    assert play.locator("#bend legend").inner_text() == "State"
    assert play.locator("#bend label").all_inner_texts() == NAMES
    assert "over states" in play.locator("section.rating").inner_text()
    for number, name in enumerate(NAMES):
        play.get_by_label(name, exact=True).check(force=True)
        low, high = round(said[number].min()), round(said[number].max())
        spoken(play).to_have_attribute(
            "aria-label", f"Metric M over the sites, from {low} to {high} counts in this state"
        )


def test_the_page_scores_all_states_as_the_model_does(
    play: Page, model: tuple[Scene, Checker]
) -> None:
    scene, checker = model
    base = baseline_design(scene)
    said = checker.run(base.phi[None], base.power[None], np.array(scene.state_axis))["score"][0]
    assert play.evaluate("tactilux.design().score.value") == pytest.approx(float(said), abs=0.05)


def drawn(scene: Scene, state: float, exposure: float) -> np.ndarray:
    """Return the picture of the preview of the plain sensor of that skin, a ball pressed in."""
    one, _ = in_state(scene, state)
    chart, uv, base = SkinChart(one, 0.0), np.array([CENTER]), baseline_design(scene)
    body = replace(ball(one), center=chart.flat(uv), turn=chart.frames(uv))
    with Preview(one, imprint=body) as preview:
        light = preview.picture(base.phi, base.power, 0.0, *SIZE)
    return encode_srgb(np.asarray(light, np.float64) * exposure / 255).astype(np.float64)


def test_the_camera_sees_the_touch_on_the_skin_of_that_state(
    play: Page, model: tuple[Scene, Checker]
) -> None:
    scene, checker = model
    for number, state in enumerate(scene.state_axis):
        expected, seen = (
            drawn(scene, state, checker.exposure),
            camera_picture(play, 1, number, CENTER, SIZE),
        )
        pad, shown = expected.sum(axis=-1) > 0, seen.sum(axis=-1) > 0
        # The preview's pixels on the border see a part of the pad, those of the page their middle.
        assert (pad == shown).mean() > 0.95
        # The camera stands over a row of pixels here: no ray of that row is lost.
        for seen_at in (pad, shown):
            assert (seen_at[1:-1] | ~(seen_at[:-2] & seen_at[2:])).all()
        off = np.abs(seen - expected)[pad & shown].mean()
        assert off < 12.0
        # Turned or mirrored it is another picture.
        assert np.abs(seen[:, ::-1] - expected)[pad & shown].mean() > 1.5 * off
    # The low skin lies nearer to the camera.
    sizes = [
        (camera_picture(play, 9, number, CENTER, SIZE).sum(axis=-1) > 0).sum() for number in (0, 1)
    ]
    assert sizes[1] > sizes[0]
