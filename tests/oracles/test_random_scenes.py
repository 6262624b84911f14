"""Random sensors as scene files."""

from __future__ import annotations

from pathlib import Path

import pytest

from render.scene import load_scene
from tests.oracles.random_scenes import random_content, random_scene, scene_text


@pytest.mark.parametrize("seed", range(1, 8))
def test_a_random_sensor_is_the_same_from_its_file(tmp_path: Path, seed: int) -> None:
    file = tmp_path / "sensor.toml"
    file.write_text(scene_text(random_content(seed)))
    assert load_scene(file).hash == random_scene(seed).hash
    assert random_scene(seed).name == f"random-{seed}"
    assert random_scene(seed).hash != random_scene(seed + 1).hash
