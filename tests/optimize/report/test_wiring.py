"""The wiring sheet speaks of the lamps that a scene has."""

from __future__ import annotations

import html
import io
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.image import imread

from optimize.design import Design, baseline_design
from optimize.mounting import mount
from optimize.placement import candidates_of, searched_scene
from optimize.report import render_page, wiring_context
from optimize.report.wiring import wiring_drawing
from render.scene import Scene, load_scene
from tests.colored_skins import content_with, of

if TYPE_CHECKING:
    from playwright.sync_api import Browser

STILL = {
    "count": 2, "turns": False, "profile": "lambertian", "diameter": of(1.0, "mm"),
    "gap": of(0.8, "mm"), "height": of(2.0, "mm"),
}  # fmt: skip
INFRARED = [{"name": "infrared", "response": {"value": [1.0], "source": "test"}}]


def sensor(*edges: str, turns: bool = False) -> Scene:
    """Return a sensor of infrared lamps on ``edges``, before a camera of one channel."""
    content = content_with(0.5) | {"colors": INFRARED}
    del content["fibers"]
    content["camera"] = content["camera"] | {"channels": ["ir"]}
    content["rows"] = [STILL | {"edge": edge, "turns": turns} for edge in edges]
    content["baseline"] = dict.fromkeys(edges, "infrared")
    return Scene.model_validate(content, context={"colors": ("infrared",)})


def sheet(scene: Scene) -> str:
    """Return the sheet of the scene's baseline, as its page has it."""
    wiring = wiring_context(mount(scene, baseline_design(scene), lambda _: 7.0), "Baseline")
    content = {"wiring": wiring, "scene": scene.name, "scene_hash": scene.hash}
    content |= {"bends": [0.0], "facts": []}
    return " ".join(html.unescape(render_page("wiring.html.j2", content)).split())


def test_lamps_that_do_not_turn_have_no_angles() -> None:
    still, turning = sheet(sensor("left", "base")), sheet(sensor("left", "base", turns=True))
    for words in ("Angles are rounded", "What other steps would take", "90° points", "Leans"):
        assert words in turning
        assert words not in still
    assert "on the tip and base edge 0° points right" in turning
    assert "Searches keep to this" not in still


def test_numbers_are_told_for_the_edges_that_have_lamps() -> None:
    both, alone = sheet(sensor("left", "base")), sheet(sensor("right"))
    assert (
        "lamps are numbered along the left edge from base to tip and along the base from right "
        "to left." in both
    )
    assert "lamps are numbered down the right edge." in alone
    assert "fiber" not in both + alone


def test_a_lamp_below_full_power_has_the_level_that_its_board_is_told() -> None:
    scene = load_scene("digit")
    base = baseline_design(scene)
    dimmed = replace(base, drive=base.drive * np.array([[1.0], [0.37], [1.0]]))
    contexts = [wiring_context(mount(scene, design), "") for design in (base, dimmed)]
    colors = [[lamp["color"] for lamp in context["fibers"]] for context in contexts]
    assert colors == [["blue", "green", "red"], ["blue", "green, 94", "red"]]  # 0.37 of 255
    told = [any("level" in fact for fact in context["facts"]) for context in contexts]
    assert told == [False, True]


def test_one_type_of_led_is_exchanged_with_none() -> None:
    assert "may be exchanged" not in sheet(sensor("left", "right"))


@pytest.mark.slow
def test_a_phone_shows_every_column_and_a_dark_screen_a_dark_drawing(
    chromium: Browser, tmp_path: Path
) -> None:
    path, scene = tmp_path / "wiring.html", load_scene("finger20")
    wiring = wiring_context(mount(scene, baseline_design(scene)), "Baseline")
    content = {"wiring": wiring, "scene": scene.name, "scene_hash": scene.hash}
    path.write_text(render_page("wiring.html.j2", content | {"bends": [0.0], "facts": []}))
    named = ["Fiber", "Edge", "x (mm)", "y (mm)", "Color", "mA", "LED", "Channel", "Angle", "Leans"]
    for width in (320, 390, 1280):
        view = {"width": width, "height": 700}
        with chromium.new_context(viewport=view, color_scheme="dark") as context:  # type: ignore[arg-type]
            page = context.new_page()
            page.goto(path.as_uri())
            row = page.locator(".lamps tbody tr").nth(9).locator("td")
            assert row.evaluate_all("cells => cells.map(c => c.dataset.label)") == named
            edges = row.evaluate_all("cells => cells.map(c => c.getBoundingClientRect().right)")
            assert all(0 < edge <= width for edge in edges)
            label = "cells => cells.map(c => getComputedStyle(c, '::before').content)"
            shown = [text.strip('"').strip() for text in row.evaluate_all(label)]
            assert (shown == named) == (width < 640)
            picture = page.locator(".sheet img")
            shot = imread(io.BytesIO(picture.screenshot()))[..., :3]
            assert shot.mean() < 0.3


def test_places_under_a_lit_body_are_not_drawn_as_empty() -> None:
    digit = load_scene("digit")
    first, far = candidates_of(digit)[0], candidates_of(digit)[9]
    beside = replace(first, position=first.position + [0.0, 0.4, 0.0])
    scene = searched_scene(digit, candidates=[first, beside, far])
    colors = np.array([-1, -1, -1, 0, -1, -1])
    design = Design.of_colors(np.full(6, np.pi / 2), colors)
    axes = wiring_drawing(mount(scene, design)).axes[0]
    circles = [line.get_xydata()[0] for line in axes.lines if line.get_markerfacecolor() == "none"]
    # Lamps of the baseline are no empty places.
    assert np.array(circles) == pytest.approx(np.array([far.position[:2]]))
