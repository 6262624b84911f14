"""Exposure and lambda belong to the scene."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from render.choose_exposure import baseline_power, scene_scale
from render.errors import TableError
from render.metric import image_counts, metric_terms
from render.preview import Preview
from render.scene import Scene, scene_text, unchecked
from tests.small_scenes import small_scene


def test_every_edge_of_the_baseline_has_its_color() -> None:
    assert baseline_power(small_scene()).argmax(axis=1).tolist() == [0, 0, 0, 2, 2, 1, 1, 1]


def test_the_previews_baseline_reaches_230_counts_and_both_terms_weigh_equally() -> None:
    scene = small_scene()
    scale = scene_scale(scene)
    with Preview(scene) as preview:
        light, _ = preview.transport(np.array([np.pi / 2]), np.array(scene.bending.angles))
    counts = image_counts(light[:, 0], baseline_power(scene), scale.exposure)
    assert np.percentile(counts[0], 99.5) == pytest.approx(230.0)
    intensity, hue = metric_terms(counts)
    assert intensity.mean() == pytest.approx(scale.lam * hue.mean())


@pytest.mark.slow
def test_scenes_of_one_hash_have_one_scale() -> None:
    dimmed = small_scene(constraints={"power_red": {"value": 0.5, "source": "test"}})
    renamed = unchecked(small_scene(), {"name": "other"})
    assert dimmed.hash == renamed.hash == small_scene().hash
    assert scene_scale(dimmed) == scene_scale(renamed) == scene_scale(small_scene())


def test_a_baseline_of_one_color_is_refused_before_anything_is_rendered() -> None:
    one = {"left": "red", "tip": "red", "right": "red"}
    with pytest.raises(TableError, match=r'different colors.* left = \["red", "blue"\]$'):
        scene_scale(small_scene(baseline=one))
    # What the sentence proposes is done.
    assert scene_scale(small_scene(baseline=one | {"left": ["red", "blue", "red"]})).lam > 0.0


def test_the_hue_of_a_single_lamp_has_no_weight() -> None:
    content = tomllib.loads(scene_text("digit"))
    del content["lamps"]
    content["baseline"] = {"tip": "blue"}
    scale = scene_scale(Scene.model_validate(content))
    assert scale.lam == 0.0
    assert scale.exposure > 0.0
