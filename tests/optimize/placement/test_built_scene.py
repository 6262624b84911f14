"""A design's scene of its own has the light that the design has among all places."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optimize.design import Array, Design, baseline_design, limits_of
from optimize.placement import built_scene, searched_scene, unsaid_powers
from render.errors import DesignError
from render.preview import Preview
from render.scene import Scene, load_scene, scene_text, standalone


def facet_light(scene: Scene, design: Design) -> Array:
    """Return what facets send to the channels, ``(bend, site, facet, channel)``, unexposed."""
    with Preview(scene) as preview:
        light = preview.transport(design.phi[:, None], np.array(scene.state_axis))[0]
    return np.einsum("f...,fc->...c", light[:, 0], design.power)


def random_design(scene: Scene, seed: int) -> Design:
    rng, limits = np.random.default_rng(seed), limits_of(scene)
    colors = limits.nearest_colors(rng.uniform(size=limits.allowed.shape))
    turning = np.array(scene.turning)
    phi = np.where(turning, rng.uniform(0.6, 2.4, len(turning)), math.pi / 2)
    return Design.of_colors(limits.nearest_directions(phi), colors, scene.palette)


@pytest.mark.parametrize("name", ["digit", "gelsight-mini"])
def test_its_baseline_has_the_designs_light(name: str) -> None:
    searched = searched_scene(load_scene(name).with_(sites_columns=2, sites_rows=2))
    design = random_design(searched, 4)
    built = built_scene(searched, design, "built")
    assert built.lamp_count == int((design.colors >= 0).sum())
    expected = facet_light(searched, design)
    assert np.allclose(
        facet_light(built, baseline_design(built)), expected, rtol=1e-5, atol=1e-8 * expected.max()
    )


def test_lamps_that_turn_point_where_the_design_turned_them() -> None:
    turned = {f"rows.{number}.turns": True for number in range(3)}
    apart = {f"rows.{number}.gap": 1.0 for number in range(3)}
    tilted = {"rows.0.tilt": 10.0}
    scene = load_scene("gelsight-mini").with_(
        **turned, **apart, **tilted, sites_columns=2, sites_rows=2
    )
    searched = searched_scene(scene, lamps=4)
    design = random_design(searched, 7)
    assert np.ptp(design.phi) > 0.5
    built = built_scene(searched, design, "built")
    assert built.rows is None
    assert all(built.turning)
    expected = facet_light(searched, design)
    assert np.allclose(
        facet_light(built, baseline_design(built)), expected, rtol=1e-5, atol=1e-8 * expected.max()
    )


def test_fibers_are_listed_where_they_point_elsewhere() -> None:
    scene = load_scene("finger20")
    base = baseline_design(scene)
    built = built_scene(scene, replace(base, phi=base.phi + 0.1), "built")
    assert built.fibers is None
    assert built.lamp_count == 20
    assert built.baseline_colors() == scene.baseline_colors()


def test_a_row_that_is_wholly_lit_stays_a_row() -> None:
    scene = load_scene("gelsight-mini")
    base = baseline_design(scene)
    colors = base.colors.copy()
    colors[5] = -1  # of the tip
    built = built_scene(scene, Design.of_colors(base.phi, colors), "built")
    assert [row.edge for row in built.lamp_rows] == ["left", "right"]
    assert built.lamps is not None
    assert len(built.lamps) == 2
    assert built.baseline.left == "red"
    assert built.baseline.tip is None
    assert built.baseline.lamps == ("blue", "blue")


def test_the_baseline_itself_is_the_sensor_again() -> None:
    for name in ("digit", "finger20", "gelsight-mini", "gelsight-flat"):
        scene = load_scene(name)
        assert built_scene(scene, baseline_design(scene), "again").hash == scene.hash


def test_its_file_is_read_again_and_says_where_values_are_from(tmp_path: Path) -> None:
    searched = searched_scene(load_scene("digit"))
    design = Design.of_colors(
        np.full(34, math.pi / 2), [0 if i == 20 else 1 if i == 30 else -1 for i in range(34)]
    )
    built = built_scene(searched, design, "mine")
    (tmp_path / "mine.toml").write_text(standalone(built).text)
    again = load_scene(tmp_path / "mine.toml")
    assert again.hash == built.hash
    assert again.name == "mine"
    text = standalone(built).text
    assert text.startswith("# Lamps and baseline are those of a design for digit-places")
    assert "searched: a place on the" in text
    assert "\n\n\n" not in text


def test_limits_follow_their_lamps(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    constraints = '[constraints]\noff = true\nfixed = [{fiber = 2, color = "red"}]\n'
    path.write_text(scene_text("digit") + constraints)
    scene = load_scene(path)
    built = built_scene(scene, Design.of_colors(np.full(3, math.pi / 2), [-1, 1, 0]), "mine")
    assert built.constraints is not None
    assert [(one.fiber, one.color) for one in built.constraints.fixed] == [(1, "red")]
    assert built.constraints.off is None


def test_power_of_a_color_is_a_limit_and_that_of_single_lamps_is_told() -> None:
    scene = load_scene("digit")
    base = baseline_design(scene)
    dimmed = replace(base, drive=base.drive * [1.0, 0.5, 1.0])
    built = built_scene(scene, dimmed, "mine")
    assert limits_of(built).led_power.tolist() == [1.0, 0.5, 1.0]
    assert unsaid_powers(dimmed) == []
    mini = baseline_design("gelsight-mini")
    uneven = replace(mini, drive=mini.drive * np.linspace(0.5, 1.0, 11)[:, None])
    assert "powers of their own" in unsaid_powers(uneven)[0]


def test_a_design_without_light_is_none() -> None:
    dark = Design.of_colors(np.full(3, math.pi / 2), [-1, -1, -1])
    with pytest.raises(DesignError, match="lights none of digit's lamps"):
        built_scene(load_scene("digit"), dark, "mine")


def test_a_design_of_shots_is_built_with_its_shots() -> None:
    scene = load_scene("digit").with_(camera_shots=2)
    colors = [scene.palette.index(name) for name in ("red@2", "green", "blue@1")]
    design = Design.of_colors(np.full(3, np.pi / 2), colors, scene.palette)
    built = built_scene(scene, design, "mine")
    assert built.palette == scene.palette
    assert baseline_design(built).color_names == design.color_names
    assert np.array_equal(baseline_design(built).drive, design.drive)
