"""The page to play with on a curved skin: scores of the model, pictures of the preview."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from optimize.design import baseline_design
from optimize.play import PlayPage, write_play
from optimize.report import encode_srgb
from optimize.scoring import open_model
from render.geometry import Imprint, SkinChart, ball, bolt
from render.preview import Preview
from render.scene import Scene, load_scene
from tests.optimize.browser import camera_picture, opened

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SIZE = 48, 64


@pytest.fixture(scope="module")
def dome() -> Scene:
    return load_scene("digit-dome")


@pytest.fixture(scope="module")
def play(
    chromium: Browser, dome: Scene, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Page]:
    path = tmp_path_factory.mktemp("play") / "page.html"
    write_play(path, PlayPage(dome, open_model(dome), optimum=baseline_design(dome)))
    with opened(chromium, path) as page:
        yield page


def test_the_page_scores_as_the_model_does(play: Page, dome: Scene) -> None:
    base, model = baseline_design(dome), open_model(dome)
    said = model.run(base.phi[None], base.power[None], model.transport_table(base.phi[:1]).bends)
    shown = play.evaluate("tactilux.design().score.value")
    assert shown == pytest.approx(float(said["score"][0]), abs=0.02)


@pytest.mark.parametrize(("touch", "make", "center"), [(0, bolt, (0, -6)), (1, ball, (4, 5))])
def test_the_camera_sees_the_touch_on_the_curved_skin(
    play: Page,
    dome: Scene,
    touch: int,
    make: Callable[[Scene], Imprint],
    center: tuple[float, float],
) -> None:
    base, chart, uv = baseline_design(dome), SkinChart(dome, 0.0), np.array([center], dtype=float)
    body = replace(make(dome), center=chart.flat(uv), turn=chart.frames(uv))
    with Preview(dome, imprint=body) as preview:
        drawn = preview.picture(base.phi, base.power, 0.0, *SIZE)
        sight = preview.sight(0.0, *SIZE)
    exposure = open_model(dome).exposure
    expected = encode_srgb(np.asarray(drawn, np.float64) * exposure / 255).astype(np.float64)
    seen = camera_picture(play, touch, 0, center, SIZE)
    pad, shown = expected.sum(axis=-1) > 0, seen.sum(axis=-1) > 0
    assert (pad == shown).mean() > 0.98
    assert np.abs(seen - expected)[pad & shown].mean() < 12.0
    # Turned or mirrored it is another picture.
    assert np.abs(seen[:, ::-1] - expected)[pad & shown].mean() > 30.0
    # What the touch changes lies where the preview has the body.
    changed = np.argwhere(
        np.abs(seen - camera_picture(play, 9, 0, center, SIZE)).sum(axis=-1) > 12.0
    )
    columns, rows = SIZE
    on_body = sight.pixel[sight.facet >= 0]
    place = np.stack([rows - 1 - on_body // columns, on_body % columns], axis=-1)
    assert len(changed) > 20
    assert np.abs(changed.mean(axis=0) - place.mean(axis=0)).max() < 2.5


def test_no_word_is_lost_on_bends_or_states_where_there_is_one(play: Page) -> None:
    text = play.evaluate("document.body.textContent.replace(/<script.*?script>/gs, '')")
    body = text[: text.index('{"')]
    assert "Spread over sites" in body
    assert not re.search(r"\b(bend|state)", body, re.IGNORECASE)
    assert play.locator("#bend").count() == 0
    play.get_by_label("Baseline", exact=True).check(force=True)
    play.wait_for_function(
        "document.getElementById('heat').getAttribute('aria-label').endsWith('counts')"
    )
