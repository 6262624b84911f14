"""What was meant is said beside what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from render.errors import SceneError
from render.refused_values import did_you_mean
from render.scene import load_scene, scene_text

Run = Callable[..., Any]


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("gelsight_mini", "gelsight-mini"),
        ("GelSight-Mini", "gelsight-mini"),
        ("gelsightmini", "gelsight-mini"),
        ("fingr20", "finger20"),
        ("finger", "finger20 or finger24"),
        ("dome", "digit-dome"),
    ],
)
def test_a_scene_that_is_nearly_one_of_those_shipped_is_named(said: str, meant: str) -> None:
    with pytest.raises(SceneError, match=f", did you mean {meant}\\?$"):
        load_scene(said)


def test_what_is_near_to_nothing_is_told_what_there_is_alone() -> None:
    assert did_you_mean("xyz", ["finger20", "digit"]) == ""
    assert did_you_mean("", ["finger20", "digit"]) == ""
    assert did_you_mean(7, ["finger20", "digit"]) == ""


def test_a_file_beside_it_is_named_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fingertip.toml").write_text(scene_text("finger20"))
    for said in ("fingertip", "fingertp.toml"):
        with pytest.raises(SceneError, match=r", did you mean fingertip\.toml\?$"):
            load_scene(said)


def test_a_word_of_a_scene_file_is_named_where_some_are_allowed(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(scene_text("finger20").replace('left = "red"', 'left = "redd"'))
    with pytest.raises(SceneError, match="did you mean red\\?"):
        load_scene(path)
    path.write_text(scene_text("finger24").replace('edge = "left"', 'edge = "lefft"', 1))
    with pytest.raises(SceneError, match="did you mean left\\?"):
        load_scene(path)


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("explore", "--robust", "quantil"), "quantile"),
        (("colors", "t.npz", "--method", "quik"), "quick"),
        (("new", "mine", "--lamp", "leds"), "led"),
        (("new", "mine", "--colors", "grean"), "green"),
        (("render", "finger20", "--press", "bal"), "ball"),
        (("hw", "set", "d.json", "--protocol", "wledd"), "wled"),
    ],
)
def test_an_option_of_few_choices_names_the_nearest(
    tactilux: Run, words: tuple[str, ...], meant: str
) -> None:
    done = tactilux(*words)
    assert done.code == 2
    assert done.err.rstrip().endswith(f"did you mean {meant}?")
