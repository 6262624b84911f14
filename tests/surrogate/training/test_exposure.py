"""Exposure and lambda of a scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from render.errors import TableError
from render.metric import image_counts, metric_terms
from render.scene import Scene
from render.transport import TransportTable
from surrogate.training.exposure import baseline_power, exposure_and_lambda


def test_every_edge_of_the_baseline_has_its_color(scene: Scene) -> None:
    assert baseline_power(scene).argmax(axis=1).tolist() == [0, 0, 0, 2, 2, 1, 1, 1]


def test_the_baseline_reaches_230_counts_at_bend_0_and_both_terms_weigh_equally(
    scene: Scene, reference: TransportTable
) -> None:
    exposure, lam = exposure_and_lambda(scene, reference)
    light = reference.at(np.full(scene.fibers.count, np.pi / 2))[:, [0, 2, 4]]
    counts = image_counts(light, baseline_power(scene), exposure)
    assert np.percentile(counts[0], 99.5) == pytest.approx(230.0)
    intensity, hue = metric_terms(counts)
    assert intensity.mean() == pytest.approx(lam * hue.mean())


def test_a_table_that_ends_before_the_scenes_bends_is_refused(
    scene: Scene, reference: TransportTable
) -> None:
    short = replace(reference, bends=reference.bends / 2)
    with pytest.raises(TableError, match="spans bends 0 to 45 deg, allowed: the scene's 0 to 90"):
        exposure_and_lambda(scene, short)
