"""A wrong value, at any key of a design file, is told in the words of the house."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.design import (
    Design,
    Rating,
    ScoreSettings,
    baseline_design,
    load_design_file,
    save_design,
)
from render.errors import DesignError
from render.scene import RGB, Palette, load_scene
from tests.conftest import Run
from tests.wrong_values import FOREIGN, WRONG, Place, changed, places

PALETTE = Palette(
    ("white", "amber"), ((1.0, 1.0, 0.8), (1.0, 0.4, 0.0)), RGB.names, ("#eeeeee", "#ffbf00")
)
RATING = Rating("surrogate", 90.0, (88.0, 92.0), 110.0, 15.0, 5.0, ScoreSettings(1e4, 60.0))
TOGETHER = ("level, score, lam, exposure and", "colors[0] =")
"""How refusals of what is right alone begin: half a rating, a palette without a color in use."""


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what a design file with every key holds."""
    scene = load_scene("finger20")
    design = baseline_design(scene)
    power = np.zeros((len(design.phi), 2))
    power[:, 0] = 1.0
    path = tmp_path_factory.mktemp("design") / "design.json"
    save_design(path, Design(design.phi, power, PALETTE), scene, RATING)
    kept = json.loads(path.read_text())
    assert isinstance(kept, dict)
    return kept


@pytest.fixture
def refusal(tmp_path: Path) -> Callable[[object], str | None]:
    """Return what is told of a file with some content, None where it is read."""

    def told(content: object) -> str | None:
        path = tmp_path / "design.json"
        path.write_text(json.dumps(content))
        try:
            load_design_file(path)
        except DesignError as error:
            return str(error).removeprefix(f"{path} is not a valid design: ")
        return None

    return told


def test_every_wrong_value_at_every_key_is_told_with_the_key_and_in_our_words(
    content: dict[str, Any], refusal: Callable[[object], str | None]
) -> None:
    where = [place for place in places(content) if place[-1] not in range(1, 20)]
    assert {"palette", "conventions", "score", "versions"} <= {place[0] for place in where}
    assert len(where) > 40
    for place in where:
        key, read = str(place[0]), 0
        for value in WRONG:
            told = refusal(changed(content, place, value))
            read += told is None
            if told is not None:
                assert "\n" not in told
                assert not [words for words in FOREIGN if words in told], (place, value, told)
                assert key in told or told.startswith(TOGETHER), (place, value, told)
        assert read < 4, place  # most of these are right nowhere


@pytest.mark.parametrize(
    ("place", "value", "told"),
    [
        (("schema",), "two", 'schema = "two", allowed: 1 or 2'),
        (("scene",), 3, "scene = 3, allowed: a text in quotes"),
        (("scene",), "", 'scene = "", allowed: a text that is not empty'),
        (("scene_hash",), "xyz", 'scene_hash = "xyz", allowed: 16 of 0-9 and a-f'),
        (("angles_deg",), {"x": 1}, 'angles_deg = {"x": 1}, allowed: a list'),
        (("angles_deg",), [], "angles_deg = [], allowed: a list of at least 1 item"),
        (("angles_deg", 3), True, "angles_deg[3] = true, allowed: a number"),
        (("power", 2), None, "power[2] = null, allowed: a list"),
        (("power", 2, 1), -0.5, "power[2][1] = -0.5, allowed: at least 0"),
        (("power", 2), [1.0], "power[2] has 1 value, allowed: "),
        (("palette", "names"), "white", 'palette.names = "white", allowed: a list'),
        (("score",), 90.0, "score = 90.0, allowed: a table"),
        (("score", "interval"), [88.0], "missing entry score.interval[1]"),
        (("score", "interval"), [1, 2, 3],
         "score.interval = [1, 2, 3], allowed: a list of at most 2 items"),
        (("conventions",), [2], "conventions = [2], allowed: a table"),
        (("versions", "numpy"), 2, "versions.numpy = 2, allowed: a text in quotes"),
        (("exposure",), 0, "exposure = 0, allowed: above 0"),
        (("lam",), float("inf"), "lam = Infinity, allowed: a finite number"),
        (("level",), "x" * 200, f'level = "{"x" * 78}…, allowed: "preview"'),
    ],
)  # fmt: skip
def test_it_names_the_key_the_value_as_written_and_what_is_right(
    content: dict[str, Any],
    refusal: Callable[[object], str | None],
    place: Place,
    value: object,
    told: str,
) -> None:
    assert told in str(refusal(changed(content, place, value)))


def test_a_file_of_another_kind_is_told_what_a_design_is(
    refusal: Callable[[object], str | None],
) -> None:
    assert refusal([1, 2]) == "all of it = [1, 2], allowed: a table"
    assert refusal("design") == 'all of it = "design", allowed: a table'


def test_a_wrong_value_exits_as_errors_of_users_do(
    content: dict[str, Any], tmp_path: Path, tactilux: Run
) -> None:
    path = tmp_path / "design.json"
    path.write_text(json.dumps(content | {"lam": "much"}))
    ran = tactilux("verify", path)
    assert (ran.code, ran.out) == (2, "")
    assert 'lam = "much", allowed: a number' in " ".join(ran.err.split())
