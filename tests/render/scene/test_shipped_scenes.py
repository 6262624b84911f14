"""Each shipped scene loads, says where its values are from, is seen, explored, and no more."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from optimize.design import baseline_design
from optimize.exploration import explore
from optimize.scoring import open_model
from render.geometry import camera_coverage
from render.scene import Scene, load_scene, scene_text, shipped_scenes, sources, unchecked
from render.scene.json_schema import scene_schema

PAGE = (Path(__file__).parents[3] / "docs" / "scenes.md").read_text()
NAMES = shipped_scenes()


@pytest.mark.parametrize("name", NAMES)
def test_it_is_found_by_its_name_and_a_page_lists_it(name: str) -> None:
    assert load_scene(name).name == name
    assert f"| `{name}` |" in PAGE


@pytest.mark.parametrize("name", NAMES)
def test_every_value_with_a_unit_or_range_has_a_source(name: str) -> None:
    values = len(re.findall(r"\bvalue = ", scene_text(name)))
    assert len(sources(name)) == values > 20
    for key, origin in sources(name).items():
        assert len(origin) > 4, key


@pytest.mark.parametrize("name", NAMES)
def test_the_camera_sees_every_site(name: str) -> None:
    assert camera_coverage(load_scene(name)).seen.all()


def fewer(scene: Scene) -> Scene:
    """Return a scene with four contacts and one lamp to a row: its search takes a second."""
    sites = unchecked(scene.sites, {"columns": 2, "rows": 2})
    rows = tuple(unchecked(row, {"count": 1}) for row in scene.rows or ())
    return unchecked(scene, {"sites": sites, "rows": rows})


@pytest.mark.parametrize("name", [name for name in NAMES if name != "finger20"])
def test_it_is_explored_at_once_on_its_preview(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # where no model is
    scene = fewer(load_scene(name))
    checker = open_model(scene, coarse=True)
    assert checker.level == "preview"
    found = explore(scene, checker)
    first, last = found.stages[0], found.stages[-1]
    assert last.rating.score >= first.rating.score
    still = ~np.array(scene.turning)
    np.testing.assert_array_equal(last.design.phi[still], baseline_design(scene).phi[still])


def test_the_fibers_of_finger24_are_those_of_its_paper() -> None:
    colors = load_scene("finger24").baseline_colors()
    assert {color: colors.count(color) for color in colors} == {"green": 6, "blue": 11, "red": 7}


def test_no_shipped_scene_says_more_than_its_schema_has() -> None:
    known = set(scene_schema()["properties"])
    for name in NAMES:
        assert set(tomllib.loads(scene_text(name))) <= known
