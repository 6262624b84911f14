"""Designs of LEDs with any names: files, layouts, baselines and limits speak of those."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from optimize.design import (
    Design,
    baseline_design,
    limits_of,
    load_design,
    load_layout,
    save_design,
)
from render.errors import DesignError
from render.scene import load_scene, scene_content, scene_of
from tests.colored_scenes import GREEN, WHITE, mono, scene_with


def test_white_is_one_line_and_is_called_white(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, WHITE + GREEN, ("white", "green", "off"))
    design = baseline_design(scene)
    assert design.color_names == ["white"] * 8 + ["green"] * 4 + ["off"] * 8
    np.testing.assert_array_equal(design.power[0], [1.0, 1.0, 0.8])
    assert not design.power[-1].any()
    assert scene_of(scene_content(scene)).palette == scene.palette
    assert scene_of(scene_content(scene)).hash == scene.hash


def test_a_design_file_keeps_names_powers_and_palette(tmp_path: Path) -> None:
    scene = mono(tmp_path)
    design = baseline_design(scene)
    drive = design.drive * np.linspace(0.2, 1.0, 20)[:, None]
    drive[3] = 0.0
    path = tmp_path / "design.json"
    save_design(path, Design(design.phi, drive, scene.palette), scene)
    again = load_design(path, scene)
    np.testing.assert_array_equal(again.drive, drive)
    assert again.palette == scene.palette
    assert again.color_names[2:4] == ["white", "off"]
    assert '"red"' not in path.read_text()
    with pytest.raises(DesignError, match="made for another scene"):
        load_design(path, load_scene("finger20"))
    broken = path.read_text().replace('"infrared"', '"purple"', 1)
    path.write_text(broken)
    with pytest.raises(DesignError, match=r"\] = .*, allowed|contradicts"):
        load_design(path, scene)


def test_a_layout_names_the_colors_of_its_scene(tmp_path: Path) -> None:
    mono(tmp_path)
    layout = tmp_path / "layout.toml"
    layout.write_text(f'scene = "scene.toml"\ncolors = "{"wi-w" * 5}"\nangles_deg = 90\n')
    _, design = load_layout(layout)
    assert design.color_names == ["white", "infrared", "off", "white"] * 5
    layout.write_text('scene = "scene.toml"\ncolors = "red"\nangles_deg = 90\n')
    with pytest.raises(DesignError, match="allowed: w, i or -, or white, infrared or off"):
        load_layout(layout)


def test_limits_are_told_by_name(tmp_path: Path) -> None:
    limits = """[constraints]
off = true
[constraints.colors.white]
max = 3
power = { value = 0.5, source = "driver" }
[[constraints.fixed]]
fiber = 2
color = "off"
"""
    found = limits_of(mono(tmp_path, limits))
    assert found.may_be_off
    assert found.led_counts.tolist() == [3, 20, 20]
    assert found.led_power.tolist() == [0.5, 1.0]
    assert found.allowed[2].tolist() == [False, False, True]
    old = scene_with(tmp_path, "[constraints]\nmax_red = 6\n", schema=1)
    assert limits_of(old).led_counts.tolist() == [6, 20, 20]
    assert not limits_of(old).may_be_off
