"""A table of lamps that cannot turn gets its samples where they move scores of colorings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from render.cells.sample_shares import floored_shares
from render.choose_exposure import ScoreScale, scene_scale
from render.geometry import mirror_image
from render.metric import design_score, image_counts, site_metric
from render.progress import OnProgress
from render.reference import RenderJob, TimeBudget
from render.scene import Scene, load_scene, unchecked
from surrogate.model.lamp_copies import copied, split_power
from surrogate.model.preview_grid import PreviewGrid, draw_grid
from surrogate.training import render_plan
from surrogate.training.render_plan import RenderTime, make_plan
from surrogate.training.table_allocation import table_shares


def an_led_on_each_side() -> Scene:
    """Return the slab of a DIGIT with its LED of the tip, and others like it left and right."""
    digit = load_scene("digit")
    (tip,) = digit.rows or ()
    rows = tuple(unchecked(tip, {"edge": edge}) for edge in ("left", "tip", "right"))
    baseline = unchecked(digit.baseline, {"lamps": None, "left": "green", "right": "red"})
    return unchecked(digit, {"rows": rows, "lamps": None, "baseline": baseline})


SCENE = an_led_on_each_side()
COLORED = unchecked(SCENE, {"coating": unchecked(SCENE.coating, {"albedo": (0.6, 0.25, 0.45)})})
PHI, FLAT = np.array([np.pi / 2]), np.zeros(1)


@pytest.fixture(scope="module")
def drawn() -> PreviewGrid:
    return draw_grid(SCENE, 1, 1)


@pytest.fixture(scope="module")
def scale() -> ScoreScale:
    return scene_scale(SCENE)


def score(transport: np.ndarray, power: np.ndarray, scale: ScoreScale) -> float:
    counts = image_counts(transport, power, scale.exposure)
    return float(design_score(site_metric(counts, scale.lam)).score)


@pytest.mark.parametrize("scene", [SCENE, COLORED], ids=["gray", "colored"])
def test_scores_of_other_colorings_have_less_noise_at_equal_samples(scene: Scene) -> None:
    drawn, scale = draw_grid(scene, 1, 1), scene_scale(scene)
    shares = table_shares(scene, drawn, PHI, FLAT, scale)
    transport = np.exp(drawn.log_transport[:, 0, ..., :-1])
    lamps, (_, *cells) = scene.lamp_count, transport.shape
    parts = [floored_shares(scene, FLAT, wanted) for wanted in (shares, 0.0 * shares)]
    rng, ratios = np.random.default_rng(1), []
    for power in np.eye(3)[rng.integers(0, 3, (8, lamps))]:
        spread = []
        for part in parts:
            # Independent relative noise of single samples, over the root of their number; a color
            # of the skin has the paths of all others, and their noise.
            sigma = 0.01 / np.sqrt(part * part.size)
            noise = sigma.transpose(2, 0, 1)[..., None] * rng.standard_normal((200, lamps, *cells))
            noise = copied(scene, noise, axis=1)
            shining = split_power(scene, power)
            spread.append(np.std([score(transport * (1 + one), shining, scale) for one in noise]))
        ratios.append((spread[1] / spread[0]) ** 2)
    assert np.exp(np.mean(np.log(ratios))) > 1.2


def test_a_dark_lamp_needs_no_samples_and_mirrored_lamps_get_the_same(
    drawn: PreviewGrid, scale: ScoreScale
) -> None:
    shares = table_shares(SCENE, drawn, PHI, FLAT, scale)
    cells = shares.transpose(2, 0, 1)[:, None]  # (lamp, node, bend, site)
    np.testing.assert_allclose(mirror_image(SCENE, cells, facets=False), cells, rtol=1e-6)
    log = drawn.log_transport.copy()
    log[1] -= 30.0
    found = table_shares(SCENE, replace(drawn, log_transport=log), PHI, FLAT, scale)
    assert found[..., 1].sum() < 1e-9 * found.sum()


def test_a_plan_of_minutes_keeps_its_shares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rendered: list[RenderJob] = []

    def render_within(jobs: list[RenderJob], *_: object, **__: object) -> int:
        rendered.extend(jobs)
        return 7

    monkeypatch.setattr(render_plan, "render_within", render_within)
    within = RenderTime(TimeBudget.of_minutes(1.0), lambda: 0.0)

    def plan(shares: np.ndarray | None, progress: OnProgress | None = None) -> object:
        return make_plan(
            [SCENE], tmp_path, seed=0, phi=PHI, bends=FLAT, samples=None, within=within,
            shares=shares, progress=progress,
        )  # fmt: skip

    shares = np.random.default_rng(0).gamma(0.5, size=(1, SCENE.sites.count, SCENE.lamp_count))
    first = plan(shares)
    assert isinstance(first, render_plan.RenderPlan)
    pressed, untouched = rendered
    assert pressed.slots is not None
    assert untouched.slots is None
    np.testing.assert_array_equal(first.allocation.shares, shares)
    # Asked again, even by a preview that is another by a bit, it renders the same.
    assert plan(np.nextafter(shares, 1.0)) == first
    assert len(rendered) == 2
