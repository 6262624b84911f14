"""Exposure and lambda belong to the scene."""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import Any

import numpy as np
import pytest

from render.choose_exposure import baseline_power, scene_scale
from render.errors import TableError
from render.metric import image_counts, metric_terms
from render.preview import Preview
from render.scene import Scene, scene_text, unchecked


def scene_with(**changes: dict[str, Any]) -> Scene:
    """Return finger20 with 8 fibers, 6 sites and 6 facets; ``changes`` replace keys of parts."""
    text = (resources.files("render") / "scenes" / "finger20.toml").read_text()
    content = tomllib.loads(text)
    content["fibers"] |= {"left": 3, "tip": 2, "right": 3}
    content["sites"] |= {"columns": 3, "rows": 2}
    content["indenter"] |= {"faces": 6}
    for part, keys in changes.items():
        content[part] = content.get(part, {}) | keys
    return Scene.model_validate(content)


def test_every_edge_of_the_baseline_has_its_color() -> None:
    assert baseline_power(scene_with()).argmax(axis=1).tolist() == [0, 0, 0, 2, 2, 1, 1, 1]


def test_the_previews_baseline_reaches_230_counts_and_both_terms_weigh_equally() -> None:
    scene = scene_with()
    scale = scene_scale(scene)
    with Preview(scene) as preview:
        light, _ = preview.transport(np.array([np.pi / 2]), np.array(scene.bending.angles))
    counts = image_counts(light[:, 0], baseline_power(scene), scale.exposure)
    assert np.percentile(counts[0], 99.5) == pytest.approx(230.0)
    intensity, hue = metric_terms(counts)
    assert intensity.mean() == pytest.approx(scale.lam * hue.mean())


@pytest.mark.slow
def test_scenes_of_one_hash_have_one_scale() -> None:
    dimmed = scene_with(constraints={"power_red": {"value": 0.5, "source": "test"}})
    renamed = unchecked(scene_with(), {"name": "other"})
    assert dimmed.hash == renamed.hash == scene_with().hash
    assert scene_scale(dimmed) == scene_scale(renamed) == scene_scale(scene_with())


def test_a_baseline_of_one_color_is_refused_before_anything_is_rendered() -> None:
    one = {"left": "red", "tip": "red", "right": "red"}
    with pytest.raises(TableError, match=r'different colors.* left = \["red", "blue"\]$'):
        scene_scale(scene_with(baseline=one))
    # What the sentence proposes is done.
    assert scene_scale(scene_with(baseline=one | {"left": ["red", "blue", "red"]})).lam > 0.0


def test_the_hue_of_a_single_lamp_has_no_weight() -> None:
    content = tomllib.loads(scene_text("digit"))
    del content["lamps"]
    content["baseline"] = {"tip": "blue"}
    scale = scene_scale(Scene.model_validate(content))
    assert scale.lam == 0.0
    assert scale.exposure > 0.0
