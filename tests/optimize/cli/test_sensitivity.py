"""``tactilux sensitivity`` ranks the tolerances that ``tactilux wiring`` ranks, on any scene."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.design import baseline_design, save_design
from optimize.exploration import rate
from optimize.mounting import mounting_error_costs
from optimize.robust import tolerances_of
from render.scene import Scene, load_scene
from surrogate.runtime import Checker

Run = Callable[..., Any]
OWN = """
[tolerances]
led_power = { distribution = "uniform", deviation = 0.1, unit = "relative", source = "bin" }
"""


@pytest.fixture
def command(small_scene: Path, small_model: Path, tmp_path: Path) -> list[object]:
    """Write a rated design; return the command that asks for its sensitivity."""
    scene, checker = load_scene(small_scene), Checker.load(small_model)
    stage = rate(checker, scene, "baseline", "Baseline", "", baseline_design(scene))
    save_design(tmp_path / "design.json", stage.design, scene, stage.rating)
    return ["sensitivity", "design.json", "--scene", small_scene, "--model", small_model]


def test_a_scene_that_declares_none_has_the_usual_tolerances_and_says_so(
    tactilux: Run, command: list[object], small_scene: Path, small_model: Path
) -> None:
    done = tactilux(*command, "--objective", "score", "--json")
    assert done.code == 0, done.err
    ranked = [entry["name"] for entry in json.loads(done.out)["sensitivities"]]
    assert set(ranked) == {"fiber_angle", "led_power", "camera_gain", "diffuser_thickness"}
    assert "small8 declares no tolerances, so they are the usual ones: 5° of every" in done.err
    # Wiring's are the same ones at the same prices, but for a coarser table.
    scene = load_scene(small_scene)
    costs = mounting_error_costs(
        Checker.load(small_model), scene, baseline_design(scene), layer=True
    )
    lost = [entry["low_loss"] for entry in json.loads(done.out)["sensitivities"]]
    np.testing.assert_allclose([cost.low for cost in costs], lost, rtol=0.1, atol=0.1)


def test_degrees_of_the_sensor_reader_are_lost_unless_another_loss_is_asked_for(
    tactilux: Run, command: list[object]
) -> None:
    done = tactilux(*command)
    assert done.code == 0, done.err
    assert "in degrees of the sensor reader" in done.out
    told = json.loads(tactilux(*command, "--json").out)
    assert told["objective"] == "sensor"
    lost = {entry["name"]: entry["low_loss"] for entry in told["sensitivities"]}
    assert abs(lost["camera_gain"]) < 0.001 < lost["led_power"]
    refused = tactilux(*command, "--objective", "place", "--samples", 1)
    assert refused.code == 2
    assert "--samples, which checks slopes of S, allowed: score" in refused.err


def test_what_a_scene_declares_is_what_both_rank(
    tactilux: Run, command: list[object], small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    own = tmp_path / "own.toml"
    own.write_text(small_scene.read_text() + OWN)
    done = tactilux(*(own if word is small_scene else word for word in command), "--json")
    assert done.code == 0, done.err
    assert [entry["name"] for entry in json.loads(done.out)["sensitivities"]] == ["led_power"]
    assert "usual" not in done.err
    scene: Scene = load_scene(own)
    (cost,) = mounting_error_costs(Checker.load(small_model), scene, baseline_design(scene))
    assert cost.what == "5.77 % of every LED's power"  # one standard deviation of 10 % uniform


def test_lamps_that_do_not_turn_have_no_error_of_their_angle() -> None:
    assert set(tolerances_of(load_scene("digit"))) == {"led_power", "camera_gain"}
