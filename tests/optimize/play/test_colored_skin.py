"""The page to play with of a skin whose albedo depends on the channel."""

from __future__ import annotations

import base64
import io
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.image import imread

from optimize.design import Design, baseline_design, limits_of
from optimize.objectives import ReaderName
from optimize.play import PlayPage, write_play
from optimize.play.play_page import PHI_NODES
from optimize.readers import CameraModel
from optimize.report import encode_srgb
from optimize.scoring import TableScorer
from optimize.search import ReaderObjective, refine_locally
from render.chebyshev import chebyshev_nodes
from render.geometry import bolt
from render.preview import Preview
from surrogate.preview_model import preview_checker
from surrogate.runtime import Checker
from tests.colored_skins import skin_of
from tests.optimize.browser import opened

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SCENE = skin_of()


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Checker:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        return preview_checker(SCENE, coarse=True)


@pytest.fixture(scope="module")
def play(
    chromium: Browser, model: Checker, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Page]:
    path: Path = tmp_path_factory.mktemp("play") / "page.html"
    write_play(path, PlayPage(SCENE, model, optimum=baseline_design(SCENE), objective="score"))
    with opened(chromium, path) as page:
        yield page


@pytest.fixture(scope="module")
def scorer(model: Checker) -> TableScorer:
    """Scores on the table that the page has; narrow beams are known less well between its nodes."""
    table = model.transport_table(chebyshev_nodes(PHI_NODES, 0.0, np.pi))
    return TableScorer(table, limits=limits_of(SCENE))


def test_scores_are_those_of_the_models_table(play: Page, scorer: TableScorer) -> None:
    rng = np.random.default_rng(1)
    phi, power = rng.uniform(0, np.pi, (100, 2)), rng.uniform(0, 1, (100, 2, 3))
    said = np.array([scorer.score(*design) for design in zip(phi, power, strict=True)])
    found = play.evaluate(
        "([phi, power]) => phi.map((p, i) => tactilux.rate(p, power[i]).score)",
        [np.degrees(phi).tolist(), power.tolist()],
    )
    assert np.ptp(said) > 10.0
    assert np.abs(np.array(found) - said).max() < 0.1  # of sixteen bits


@pytest.mark.parametrize("reader", ["sensor", "place"])
def test_degrees_are_those_of_the_models_table(
    play: Page, scorer: TableScorer, reader: ReaderName
) -> None:
    rng, goal = (
        np.random.default_rng(2),
        ReaderObjective(scorer, SCENE, reader, CameraModel.of(SCENE)),
    )
    for _ in range(8):
        design = Design(rng.uniform(0, np.pi, 2), rng.uniform(0, 1, (2, 3)))
        said = play.evaluate(
            "([p, a, reader]) => tactilux.rate(p, a)[reader]",
            [np.degrees(design.phi).tolist(), design.drive.tolist(), reader],
        )
        assert said == pytest.approx(-goal.value(design), rel=1e-3)  # of sixteen bits


def test_the_camera_sees_what_the_preview_draws(play: Page, model: Checker) -> None:
    base, press, width, height = baseline_design(SCENE), bolt(SCENE), 45, 54
    with Preview(SCENE, imprint=press) as preview:
        drawn = preview.picture(base.phi, base.power, 0.0, width, height)
    expected = encode_srgb(np.asarray(drawn, np.float64) * model.exposure / 255).astype(np.float64)
    at = [0, 0, press.center[0, :2].tolist(), width, height]
    url = play.evaluate("(a) => tactilux.picture(...a)", at)
    seen = 255.0 * imread(io.BytesIO(base64.b64decode(url.partition(",")[2])))[..., :3]
    pad = (expected.sum(axis=-1) > 0) & (seen.sum(axis=-1) > 0)
    # The page's light on the skin is a sketch, but alike in all channels (blue is off here).
    red, green = seen[pad].mean(axis=0)[:2] / expected[pad].mean(axis=0)[:2]
    assert red == pytest.approx(1.0, abs=0.1)
    assert red / green == pytest.approx(1.0, abs=0.02)


def test_uphill_climbs_by_the_slopes_of_each_channel(play: Page, scorer: TableScorer) -> None:
    play.get_by_role("button", name="Push uphill").click()
    end = time.monotonic() + 300
    while not play.evaluate("!tactilux.climbing()"):
        assert time.monotonic() < end
        play.wait_for_timeout(200)
    found = play.evaluate("tactilux.design()")
    design = Design(np.radians(found["angles_deg"]), np.array(found["power"]))
    base, score = baseline_design(SCENE), scorer.score(design.phi, design.power)
    assert found["score"]["value"] == pytest.approx(score, abs=0.1)
    assert score > scorer.score(base.phi, base.power)
    assert refine_locally(scorer, design).score < score + 0.1
