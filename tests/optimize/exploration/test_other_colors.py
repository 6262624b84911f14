"""A scene of a mono camera is explored on its preview, and speaks of its own LEDs alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from optimize.exploration import explore
from optimize.mounting import mount, wiring_csv
from optimize.report.exploration_report import explore_pictures
from optimize.scoring import open_model
from render.choose_exposure import baseline_power, scene_scale
from render.metric import site_metric
from tests.colored_scenes import mono


@pytest.mark.slow
def test_a_mono_camera_is_explored_on_the_preview(tmp_path: Path) -> None:
    scene = mono(tmp_path, "[constraints]\noff = true\n", small=True)
    scale = scene_scale(scene)
    assert scale.lam == 0.0
    assert baseline_power(scene).shape == (8, 1)
    checker = open_model(scene, coarse=True)
    assert checker.metadata.channels == ["gray"]
    found = explore(scene, checker)
    design, first = found.stages[-1].design, found.stages[0]
    assert set(design.color_names) <= {"white", "infrared", "off"}
    assert design.power.shape == (8, 1)
    counts = first.counts
    assert counts.shape[-1] == 1
    plain = counts[..., 0].mean(axis=-1) - counts[..., 0].std(axis=-1)
    np.testing.assert_allclose(site_metric(counts.astype(float), 0.0), plain, rtol=1e-5)
    np.testing.assert_allclose(first.metric, plain, rtol=1e-4)
    assert "white" in wiring_csv(mount(scene, first.design))
    assert not any(name in wiring_csv(mount(scene, design)) for name in (",red,", ",green,"))
    pictures = dict(explore_pictures(found))
    assert pictures["facets-optimized"][:4] == b"\x89PNG"
