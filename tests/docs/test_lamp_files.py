"""The page on scenes shows profiles and files of lamps that load as it says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from render.scene import Profile, Scene, load_scene, scene_text

PAGE = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text(encoding="utf-8")


def block(kind: str, word: str) -> str:
    """Return the one block of a kind on the page that holds a word."""
    (found,) = (one for one in re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL) if word in one)
    return str(found)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in (
        ("led.csv", block("csv", "intensity")),
        ("led.ies", block("ies", "TILT")),
        ("lamps.csv", block("csv", "direction_x")),
    ):
        (tmp_path / name).write_text(text)
    return tmp_path


def rows_scene(folder: Path, rows: str) -> Scene:
    """Return the finger with the rows of the page in place of its fibers."""
    text = scene_text("finger20").replace("schema = 1", "schema = 2")
    fibers, baseline = text.index("[fibers]"), text.index("[baseline]")
    text = text[:fibers] + text[text.index("[camera]") : baseline] + '[baseline]\nleft = "red"\n'
    (folder / "scene.toml").write_text(text + rows)
    return load_scene(folder / "scene.toml")


def test_each_form_of_a_profile_loads(folder: Path) -> None:
    text = block("toml", "cosine_exponent")
    used, *others = re.findall(r"^(?:# or: )?(profile = .*)$", text, re.MULTILINE)
    found: list[Profile] = []
    for form in (used, *others, 'profile = "lambertian"'):
        rows = rows_scene(folder, text.replace(used, form, 1)).rows
        assert rows is not None
        found.append(rows[0].profile)
    exponent, by_angle, gaussian, table, ies, lambertian = found
    assert by_angle.shape(np.radians(30.0)) == pytest.approx(0.5)
    assert exponent.shape(np.radians(30.0)) == pytest.approx(0.5, abs=0.01)
    assert gaussian.sigma_v == pytest.approx(np.radians(15.0))
    assert table == ies
    assert lambertian.cosine_exponent == 1.0


def test_the_file_of_lamps_loads(folder: Path) -> None:
    text = scene_text("finger20").replace(
        "schema = 1", f"schema = 2\n{block('toml', 'lamps_file')}"
    )
    lamps = 'lamps = ["red", "green", "blue"]'
    (folder / "scene.toml").write_text(text.replace("[baseline]", f"[baseline]\n{lamps}"))
    found = load_scene(folder / "scene.toml").lamps or ()
    assert [lamp.position[0] for lamp in found] == [-5.0, 0.0, 5.0]
    assert [lamp.turns for lamp in found] == [False, True, False]
    assert found[0].profile.cosine_exponent == 1.0
    assert found[1].profile == found[2].profile
