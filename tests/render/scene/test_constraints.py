"""Limits of designs: what they allow, and that the impossible is named."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from render.describe import describe
from render.errors import SceneError
from render.scene import Scene, load_scene

FORBID = """
[[constraints.forbidden]]
low = { value = %g, unit = "deg", source = "body" }
high = { value = %g, unit = "deg", source = "body" }
"""


@pytest.fixture
def scene_with(tmp_path: Path) -> Callable[[str], Scene]:
    """Load finger20 with more sections."""
    text = (resources.files("render") / "scenes" / "finger20.toml").read_text()

    def load(more: str) -> Scene:
        path = tmp_path / "scene.toml"
        path.write_text(text + more)
        tomllib.loads(path.read_text())
        return load_scene(path)

    return load


def test_limits_and_tolerances_change_no_hash(scene_with: Callable[[str], Scene]) -> None:
    limited = scene_with("[constraints]\nmax_red = 6\n[tolerances]\nled_power = "
                         '{ distribution = "normal", deviation = 0.1, unit = "relative", '
                         'source = "x" }')  # fmt: skip
    assert limited.hash == load_scene("finger20").hash == "68471ad4c129ea4d"
    assert "at most 6 red fibers" in describe(limited).text()
    assert "led_power: normal, standard deviation 10 %" in describe(limited).text()


def test_limits_of_colors_by_name_are_limits_like_others(tmp_path: Path) -> None:
    text = (resources.files("render") / "scenes" / "finger20.toml").read_text()
    scenes = []
    for order in ("red, blue", "blue, red"):
        path = tmp_path / "named.toml"
        more = "".join(f"\n[constraints.colors.{name}]\nmax = 2\n" for name in order.split(", "))
        path.write_text(text.replace("schema = 1", "schema = 2") + more)
        scenes.append(load_scene(path))
    first, second = scenes
    assert first == second
    assert hash(first) == hash(second)
    assert first.hash == load_scene("finger20").hash
    assert "at most 2 red fibers" in describe(first).text()
    assert first.constraints is not None
    assert first.constraints.max_counts(first.palette, 20) == (2, 20, 2)


def test_forbidden_directions_leave_the_rest(scene_with: Callable[[str], Scene]) -> None:
    limits = scene_with("[constraints]\n" + FORBID % (0, 30) + FORBID % (80, 100)).constraints
    assert limits is not None
    assert np.degrees(limits.intervals(5)) == pytest.approx(np.array([[30, 80], [100, 180]]))


def test_steps_skip_what_is_forbidden(scene_with: Callable[[str], Scene]) -> None:
    step = 'angle_step = { value = 45.0, unit = "deg", source = "jig" }\n'
    limits = scene_with("[constraints]\n" + step + FORBID % (40, 100)).constraints
    assert limits is not None
    assert np.degrees(limits.grid(0) or []) == pytest.approx(np.array([0, 135, 180]))


def test_a_fixed_direction_needs_not_be_on_a_step(scene_with: Callable[[str], Scene]) -> None:
    limits = scene_with(
        '[constraints]\nangle_step = { value = 45.0, unit = "deg", source = "jig" }\n'
        '[[constraints.fixed]]\nfiber = 2\nangle = { value = 33.0, unit = "deg", source = "x" }\n'
    ).constraints
    assert limits is not None
    assert limits.grid(2) is None
    assert np.degrees(limits.intervals(2)) == pytest.approx(np.array([[33, 33]]))


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        ("max_red = 5\nmax_green = 5\nmax_blue = 5", "at least 20 together"),
        ("max_red = 0\n[[constraints.fixed]]\nfiber = 1\ncolor = 'red'", "at most max_red = 0"),
        ("[[constraints.fixed]]\nfiber = 20\ncolor = 'red'", "fiber 20, allowed: 0 to 19"),
        (FORBID % (0, 180), "no direction for fiber 0"),
        (FORBID % (0, 90) + FORBID % (90, 180), "no direction for fiber 0"),
        (FORBID % (90, 90), "allowed: low below high"),
        ("max_red = -1", "allowed: 0 to 192"),
        ("color_order = 'rgb'", "unknown key constraints.color_order"),
        (
            "[[constraints.fixed]]\nfiber = 1\ncolor = 'red'\n"
            "[[constraints.fixed]]\nfiber = 1\ncolor = 'blue'",
            "names fiber 1 twice",
        ),
    ],
)
def test_what_cannot_be_fulfilled_is_named(
    scene_with: Callable[[str], Scene], more: str, sentence: str
) -> None:
    with pytest.raises(SceneError, match=sentence):
        scene_with("[constraints]\n" + more)


def test_tolerances_say_what_form_they_want(scene_with: Callable[[str], Scene]) -> None:
    with pytest.raises(SceneError, match='unit = "deg", source'):
        scene_with("[tolerances]\nfiber_angle = 3.0\n")
    with pytest.raises(SceneError, match="above 0"):
        scene_with('[tolerances]\nled_power = { distribution = "normal", deviation = 0.0, '
                   'unit = "relative", source = "x" }')  # fmt: skip
    with pytest.raises(SceneError, match='"normal" or "uniform"'):
        scene_with('[tolerances]\nled_power = { distribution = "cauchy", deviation = 0.1, '
                   'unit = "relative", source = "x" }')  # fmt: skip


def test_draws_have_the_stated_spread(scene_with: Callable[[str], Scene]) -> None:
    tolerances = scene_with(
        '[tolerances]\nfiber_angle = { distribution = "uniform", deviation = 3.0, unit = "deg", '
        'source = "x" }'
    ).tolerances
    assert tolerances is not None
    spread = tolerances.spreads()["fiber_angle"]
    drawn = np.degrees(spread.draw(np.random.default_rng(0), (20000,)))
    assert np.abs(drawn).max() <= 3.0
    assert drawn.std() == pytest.approx(np.degrees(spread.sigma), rel=0.02)
