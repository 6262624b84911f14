"""Differences of designs on a model and by renders: their intervals, and when they decide."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from optimize.comparison import (
    DesignComparison,
    NamedDesign,
    compare_by_renders,
    compare_on_model,
    render_comparison,
)
from optimize.design import Design, ScoreSettings, baseline_design
from optimize.objectives import READERS
from optimize.readers import CameraModel, expected_error
from optimize.scoring import search_table
from optimize.verification import DesignRenders, RenderDesigns
from render.metric import design_score, image_counts, site_metric
from render.reference import EVERYTHING, SampleAllocation
from render.scene import Scene, load_scene
from surrogate.runtime import Checker
from tests.optimize.browser import look

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Browser

MODELS = Path(__file__).parents[3] / "models"
NAMES = ("baseline", "turned", "the same", "red")


@pytest.fixture(scope="module")
def designs(finger20: Scene) -> list[NamedDesign]:
    base = baseline_design(finger20)
    turned = Design(np.clip(base.phi + 0.2, 0, np.pi), base.drive)
    red = Design.of_colors(base.phi, [0] * 20)
    return [
        NamedDesign(name, Path(f"{name}.json"), finger20, design)
        for name, design in zip(NAMES, (base, turned, base, red), strict=True)
    ]


@pytest.fixture(scope="module")
def models(finger20: Scene, finger20_checker: Checker) -> dict[str, Checker]:
    return {finger20.hash: finger20_checker}


@pytest.fixture(scope="module")
def on_model(
    finger20: Scene, finger20_checker: Checker, designs: list[NamedDesign]
) -> DesignComparison:
    return compare_on_model(designs, {finger20.hash: finger20_checker})


def noisy_renders(checker: Checker, common: float, own: float) -> RenderDesigns:
    """Return what renders the model's table, with noise that designs share and noise of each."""
    table, rng = search_table(checker), np.random.default_rng(4)

    def render(
        designs: Sequence[Design],
        *,
        samples: int,
        seeds: Sequence[int],
        title: str,
        allocation: SampleAllocation = EVERYTHING,
    ) -> DesignRenders:
        light = np.stack([table.at(design.phi) for design in designs])
        size = (8 * len(seeds), 1, *light.shape[1:])
        shared = 1.0 + common * rng.standard_normal(size)
        alone = 1.0 + own * rng.standard_normal((size[0], *light.shape))
        noisy = light * shared * alone
        error = noisy.std(axis=0, ddof=1) / math.sqrt(size[0])
        return DesignRenders(tuple(designs), noisy, noisy.mean(axis=-1), error, 1.0)

    return render


def true_score(checker: Checker, design: Design) -> float:
    """Return S of the model's table without noise, from the metric alone."""
    light = search_table(checker).at(design.phi)
    counts = image_counts(light, design.power, checker.exposure)
    return float(design_score(site_metric(counts, checker.lam)).score)


def test_every_pair_is_compared_once(on_model: DesignComparison) -> None:
    pairs = [(one.first, one.second) for one in on_model.differences]
    assert pairs == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    for one in on_model.differences:
        scores = [on_model.stages[index].rating.score for index in (one.first, one.second)]
        assert one.score is not None
        assert one.score[0] == pytest.approx(scores[1] - scores[0])
    assert on_model.pair(on_model.differences[0]) == "B - A"


def test_on_a_model_a_difference_reaches_further_than_a_score_unless_designs_are_equal(
    on_model: DesignComparison, finger20_checker: Checker
) -> None:
    turned, same = on_model.differences[:2]
    assert turned.score is not None
    assert same.score is not None
    half = (turned.score[1][1] - turned.score[1][0]) / 2
    assert half == pytest.approx(math.sqrt(2) * finger20_checker.score_half_width)
    assert same.score[1] == (0.0, 0.0)
    assert on_model.verdict(same) == "both read alike, tie in S"
    assert turned.turned is not None
    assert (turned.recolored, round(turned.turned, 1)) == (0, 11.5)


def test_one_color_everywhere_is_never_called_better_in_score(
    finger20: Scene, finger20_checker: Checker, designs: list[NamedDesign]
) -> None:
    poor = Design.of_colors(designs[0].design.phi, np.arange(20) % 3)
    pair = [NamedDesign("poor", Path("poor.json"), finger20, poor), designs[3]]
    found = compare_on_model(pair, {finger20.hash: finger20_checker})
    (one,) = found.differences
    assert one.score is not None
    assert one.score[1][0] > 0
    assert one.better == 0
    assert one.better_in_score is None
    assert found.verdict(one) == "A reads better, undecided in S"
    assert any("tells no azimuth" in text for text in found.warnings)
    found = compare_by_renders(
        found,
        lambda _: noisy_renders(finger20_checker, 0.01, 0.01),
        {finger20.hash: finger20_checker},
        samples=9,
        seeds=(1, 2),
    )
    assert found.differences[0].better_in_score is None


def test_renders_of_common_paths_are_paired_and_hold_the_true_difference(
    on_model: DesignComparison,
    finger20_checker: Checker,
    designs: list[NamedDesign],
    models: dict[str, Checker],
) -> None:
    render = noisy_renders(finger20_checker, common=0.08, own=0.004)
    found = compare_by_renders(on_model, lambda _: render, models, samples=100, seeds=(1, 2))
    assert found.stages[0].rating.level == "reference"
    turned = found.differences[0]
    assert turned.score is not None
    low, high = turned.score[1]
    scores = [true_score(finger20_checker, entry.design) for entry in designs]
    assert low < scores[1] - scores[0] < high
    # Unpaired, the intervals of both scores would add up in quadrature.
    halves = [(stage.rating.interval[1] - stage.rating.interval[0]) / 2 for stage in found.stages]
    assert (high - low) / 2 < 0.5 * math.hypot(*halves[:2])
    for reader in READERS:
        value, (least, most) = turned.errors[reader]
        model = [stage.error(reader) for stage in on_model.stages[:2]]
        # Errors and their difference may be known best in other ways: by the model, or without it.
        errors = [stage.rendered[reader] for stage in found.stages[:2]]
        reach = math.hypot(*(one.se for one in errors))
        assert errors[1].value - errors[0].value == pytest.approx(value, abs=reach)
        # Renders are read by closed forms, which differ from the readers by some hundredths.
        assert least - 0.1 < model[1] - model[0] < most + 0.1
    assert found.verdict(found.differences[1]) == "both read alike, tie in S"


def test_renders_of_two_sensors_hold_the_difference_of_their_light_without_noise() -> None:
    designs, models, true = [], {}, []
    for name in ("digit", "gelsight-flat"):
        scene = load_scene(name)
        models[scene.hash] = checker = Checker.load(MODELS / name)
        designs.append(NamedDesign(name, Path(name), scene, baseline_design(scene)))
        quiet = noisy_renders(checker, 0.0, 0.0)(
            [designs[-1].design], samples=1, seeds=(1,), title=""
        )
        exact = quiet.colors(ScoreSettings(checker.exposure, checker.lam))[0]
        true.append(expected_error("sensor", scene, CameraModel.of(scene)).degrees(exact)[0])
    rated = compare_on_model(designs, models)
    found = compare_by_renders(
        rated, lambda scene: noisy_renders(models[scene.hash], 0.02, 0.004), models,
        samples=100, seeds=(1, 2),
    )  # fmt: skip
    (one,) = found.differences
    low, high = one.errors["sensor"][1]
    assert low < true[1] - true[0] < high
    assert one.better == 1
    assert one.score is None


def test_renders_that_have_not_converged_decide_nothing(
    on_model: DesignComparison, finger20_checker: Checker, models: dict[str, Checker]
) -> None:
    render = noisy_renders(finger20_checker, common=20.0, own=0.0)
    found = compare_by_renders(on_model, lambda _: render, models, samples=1, seeds=(1, 2))
    assert {found.verdict(one) for one in found.differences} == {"undecided, undecided in S"}
    assert found.warnings[0].startswith("The renders of A have not converged")


@pytest.fixture(scope="module")
def page(on_model: DesignComparison, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of the first two designs."""
    pair = replace(on_model, stages=on_model.stages[:2], differences=on_model.differences[:1])
    path = tmp_path_factory.mktemp("page") / "page.html"
    path.write_text(render_comparison(pair, [Path("a b.json"), Path("turned.json")]))
    return path


@pytest.mark.parametrize("screen", ["desk", "phone"])
def test_the_page_shows_designs_side_by_side_on_every_screen(
    chromium: Browser, page: Path, screen: str
) -> None:
    seen = look(chromium, page, screen)
    assert seen.page <= 0
    assert seen.wide == []
    assert seen.small == []
    assert seen.blank == []
    assert seen.pictures == 2 * (3 + 3)
    assert seen.requests == []
    assert seen.complaints == []


def test_the_page_ends_with_the_command_that_decides(page: Path) -> None:
    html = page.read_text()
    command = "tactilux compare &#39;a b.json&#39; turned.json --samples 200"
    assert command in html.partition("<h2>Next</h2>")[2]


@pytest.mark.parametrize(
    ("common", "command"),
    [(0.02, "tactilux wiring "), (20.0, "tactilux compare A.json B.json --samples 28")],
)
def test_a_page_of_renders_ends_with_parts_to_order_only_where_they_decide(
    finger20: Scene,
    finger20_checker: Checker,
    common: float,
    command: str,
    monkeypatch: pytest.MonkeyPatch,
    models: dict[str, Checker],
) -> None:
    drawn = {f"preview-{key}-{bend}": b"<svg" for key in "AB" for bend in range(3)}
    monkeypatch.setattr(
        "optimize.comparison.comparison_page.camera_pictures", lambda *_: drawn.items()
    )
    base = baseline_design(finger20)
    poor = Design.of_colors(base.phi, np.arange(20) % 3)
    pair = [
        NamedDesign("base", Path("A.json"), finger20, base),
        NamedDesign("poor", Path("B.json"), finger20, poor),
    ]
    rated = compare_on_model(pair, {finger20.hash: finger20_checker})
    render = noisy_renders(finger20_checker, common, own=0.0)
    found = compare_by_renders(rated, lambda _: render, models, samples=7, seeds=(1, 2))
    html = render_comparison(found, [entry.file for entry in pair])
    assert f"<code>{command}" in html.partition("<h2>Next</h2>")[2]
