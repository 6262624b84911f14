"""The camera of the page sees what the preview draws on a colored dome and through a window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from optimize.design import baseline_design
from optimize.play import PlayPage, write_play
from optimize.report import encode_srgb
from render.geometry import SkinChart, ball
from render.preview import Preview
from render.scene import Scene, Window, load_scene, unchecked
from surrogate.preview_model import preview_checker
from tests.optimize.browser import camera_picture, opened

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Browser

SIZE, CENTER = (48, 64), (4.0, 5.0)


def colored_dome() -> Scene:
    scene = load_scene("digit-dome")
    coating = unchecked(scene.coating, {"albedo": (0.5, 0.3, 0.2)})
    return unchecked(scene, {"coating": coating})


def gel_on_a_window() -> Scene:
    scene = load_scene("digit")
    window = Window.model_construct(thickness=2.0, index=scene.pad.index + 0.1)
    return unchecked(scene, {"window": window})


@pytest.mark.parametrize("scene", [colored_dome(), gel_on_a_window()], ids=["dome", "window"])
def test_the_camera_sees_what_the_preview_draws(
    chromium: Browser, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    base, model, path = (
        baseline_design(scene),
        preview_checker(scene, coarse=True),
        tmp_path / "p.html",
    )
    write_play(path, PlayPage(scene, model, optimum=base))
    with opened(chromium, path) as page:
        seen = camera_picture(page, 1, 0, CENTER, SIZE)
    body = ball(scene)
    if scene.skin is not None:
        chart, uv = SkinChart(scene, 0.0), np.array([CENTER])
        body = replace(body, center=chart.flat(uv), turn=chart.frames(uv))
    else:
        body = replace(body, center=np.array([[*CENTER, body.center[0, 2]]]))
    with Preview(scene, imprint=body) as preview:
        drawn = preview.picture(base.phi, base.power, 0.0, *SIZE)
    expected = encode_srgb(np.asarray(drawn, np.float64) * model.exposure / 255).astype(np.float64)
    pad, shown = expected.sum(axis=-1) > 0, seen.sum(axis=-1) > 0
    assert (pad == shown).mean() > 0.98
    both = pad & shown
    off = np.abs(seen - expected)[both].mean()
    assert off < 12.0
    assert np.abs(seen[:, ::-1] - expected)[both].mean() > 2.0 * off
