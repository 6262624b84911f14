"""The page on scenes shows how several pictures of a gray camera become channels."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from optimize.design import dimmed_baseline
from optimize.exploration import rate
from optimize.readers import guessing_error
from optimize.report.page import guessing_warning
from optimize.scoring import open_model
from render.describe import describe
from render.scene import Scene, load_scene
from tests.docs.test_lamp_files import block

Run = Callable[..., Any]
GRAY = ("--camera", "gray", "--lamp", "led", "--diffuser", 0, "--width", 12, "--length", 12,
        "--left", 2, "--tip", 2, "--right", 2, "--base", 2)  # fmt: skip


@pytest.fixture
def scenes(tactilux: Run) -> tuple[Scene, Scene]:
    """Return a sensor with a gray camera as `tactilux new` writes it, and with the page's shots."""
    assert tactilux("new", "gray", *GRAY).code == 0
    text = Path("gray.toml").read_text()
    keys, rest = block("toml", "[[colors]]").removeprefix("# [camera]\n").split("\n\n", 1)
    head = text[: text.index("# The design that others")].replace('channels = ["gray"]', keys)
    Path("shots.toml").write_text(head.replace('name = "gray"', 'name = "shots"') + rest)
    return load_scene("gray.toml"), load_scene("shots.toml")


def test_a_gray_camera_is_told_of_its_shots_and_one_that_has_them_is_not(
    scenes: tuple[Scene, Scene],
) -> None:
    gray, shots = scenes
    assert shots.palette.channels == ("gray-1", "gray-2", "gray-3", "gray-4")
    (doubt,) = (told for told in describe(gray).doubts if "one channel" in told)
    assert "take a picture for each group of lamps" in doubt
    assert not [told for told in describe(shots).doubts if "hue" in told or "channel" in told]


@pytest.mark.slow
def test_a_gray_camera_hardly_reads_normals_and_four_shots_do(
    scenes: tuple[Scene, Scene],
) -> None:
    errors = []
    for scene in scenes:
        checker = open_model(scene, coarse=True)
        stage = rate(checker, scene, "baseline", "Baseline", "", dimmed_baseline(scene))
        errors.append(stage.normal_error)
    gray, shots = errors
    assert gray > 0.5 * guessing_error(scenes[0])
    assert shots < gray / 3
    (warning,) = guessing_warning(scenes[0], gray)
    assert "a guess misses them by 19.6°" in warning
    assert "(docs/scenes.md, shots)" in warning
    assert guessing_warning(scenes[1], shots) == []
