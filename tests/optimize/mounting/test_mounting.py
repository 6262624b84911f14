"""The rows of a wiring sheet say where each fiber is, where it leads, and what feeds it."""

from __future__ import annotations

import csv
import io
import math

import numpy as np
import pytest

from optimize.design import Design, baseline_design
from optimize.mounting import Feeds, mount, mounting_error_costs, surrogate_score, wiring_csv
from optimize.placement import searched_scene
from optimize.report import wiring_context
from render.geometry import flat_fiber_poses
from render.scene import Constraints, Scene, load_scene, unchecked
from surrogate.runtime import Checker


def turned(scene: Scene, degrees: float) -> Design:
    design = baseline_design(scene)
    return Design(design.phi + math.radians(degrees), design.power)


def test_rows_lead_back_to_the_beams(finger20: Scene) -> None:
    sheet = mount(finger20, turned(finger20, -22.0))
    rows = list(csv.DictReader(io.StringIO(wiring_csv(sheet))))
    poses = flat_fiber_poses(finger20)
    beams = poses.directions(sheet.design.phi)
    for axis, name in enumerate("xyz"):
        place = [float(row[f"{name}_mm"]) for row in rows]
        assert place == pytest.approx(poses.position[:, axis], abs=1e-3)
        towards = [float(row[f"towards_{name}"]) for row in rows]
        assert towards == pytest.approx(beams[:, axis], abs=1e-4)
    assert {row["angle_deg"] for row in rows} == {"70.0"}
    assert {row["found_deg"] for row in rows} == {"68.0"}
    leans = {row["edge"]: row["leans"] for row in rows}
    sides = "20° to the tip"
    assert leans == {"left": sides, "tip": "20° to the right", "right": sides}


def test_leds_channels_and_currents_follow_the_board(finger20: Scene) -> None:
    power = baseline_design(finger20).power.copy()
    power[0], power[1] = 0.0, (0.5, 0.0, 0.0)
    design = Design(np.full(20, math.pi / 2), power)
    leds = tuple(range(19, -1, -1))
    sheet = mount(finger20, design, feeds=Feeds(leds, "grb"))
    off, dim, full = sheet.fibers[:3]
    assert (off.color, off.led, off.channel, off.current_ma) == ("off", 19, None, 0.0)
    assert (dim.color, dim.led, dim.channel, dim.current_ma) == ("red", 18, 3 * 18 + 1, 10.0)
    assert (full.channel, full.current_ma) == (3 * 17 + 1, 20.0)
    assert [row.level for row in (off, dim, full)] == [0, 128, 255]
    assert sheet.fibers[8].channel == 3 * 11 + 2  # blue
    assert sheet.current == pytest.approx(18 * 20.0 + 10.0)
    plain = mount(finger20, design)
    assert [row.led for row in plain.fibers] == list(range(20))


def test_places_without_a_lamp_have_no_row() -> None:
    scene = searched_scene(load_scene("digit"))
    colors = np.full(34, -1)
    colors[[0, 10, 20]] = 0, 1, 2
    sheet = mount(scene, Design.of_colors(np.full(34, math.pi / 2), colors))
    # Lamps 1 and 2 are there, and are taken away.
    assert [row.fiber for row in sheet.fibers] == [0, 1, 2, 10, 20]
    assert sheet.current == 60.0
    facts = " ".join(wiring_context(sheet, "design")["facts"])
    assert "29 places of the search have no lamp" in facts


def test_rounding_says_what_it_takes(finger20: Scene, finger20_checker: Checker) -> None:
    score = surrogate_score(finger20_checker, finger20)
    found = turned(finger20, 11.3)
    sheet = mount(finger20, found, score)
    assert sheet.step == 5.0
    assert np.degrees(sheet.design.phi) == pytest.approx(np.full(20, 100.0))
    assert sheet.score_found == pytest.approx(score(found))
    assert sheet.score == pytest.approx(score(turned(finger20, 10.0)), abs=1e-4)
    assert list(sheet.prices) == [5.0, 10.0, 15.0, 30.0]
    assert sheet.prices[5.0] == pytest.approx(score(found) - sheet.score, abs=1e-9)
    assert sheet.prices[30.0] == pytest.approx(
        score(found) - score(turned(finger20, 0.0)), abs=1e-4
    )
    exact = mount(finger20, found, score, step=0.0)
    assert exact.design is found
    assert exact.score == exact.score_found


def test_a_scene_with_steps_of_its_own_keeps_them(finger20: Scene) -> None:
    limits = Constraints(angle_step={"value": 4.0, "unit": "deg", "source": "jig"})  # type: ignore[arg-type]
    scene = unchecked(finger20, {"constraints": limits})
    assert mount(scene, turned(scene, 2.0)).step == pytest.approx(4.0)


def test_colors_may_be_exchanged_where_no_limit_tells_them_apart(finger20: Scene) -> None:
    assert mount(finger20, turned(finger20, 0.0)).colors_exchange
    fewer = unchecked(finger20, {"constraints": Constraints(max_red=5)})
    assert not mount(fewer, turned(fewer, 0.0)).colors_exchange
    colored = unchecked(finger20.coating, {"albedo": (0.6, 0.5, 0.4)})
    tinted = unchecked(finger20, {"coating": colored})
    assert not mount(tinted, turned(tinted, 0.0)).colors_exchange


def test_errors_in_building_cost_what_perturbed_sensors_lose(
    finger20: Scene, finger20_checker: Checker
) -> None:
    costs = mounting_error_costs(finger20_checker, finger20, baseline_design(finger20))
    assert {cost.what.split(" of ")[0] for cost in costs} == {"5°", "5 %", "2 %"}
    assert [cost.low for cost in costs] == sorted((cost.low for cost in costs), reverse=True)
    assert all(cost.low > cost.mean for cost in costs)
    # Counts are proportional to the gain, so S is, but for clipping: one in ten loses 1.28 sigma.
    score = surrogate_score(finger20_checker, finger20)(baseline_design(finger20))
    (gain,) = [cost for cost in costs if "gain" in cost.what]
    assert gain.low == pytest.approx(0.02 * 1.28 * score, rel=0.4)
