"""Scenes of strangers: how deep, how long and how many, each limit named in one sentence."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from render.errors import SceneError
from render.scene import load_scene, scene_text

LAMP = (
    '[[lamps]]\nposition = { value = [0.0, -19.0, -3.0], unit = "mm", source = "a" }\n'
    'direction = { value = [0.0, 1.0, 1.0], source = "a" }\nprofile = "lambertian"\n'
    'diameter = { value = 0.1, unit = "mm", source = "a" }\n'
)
ROW = (
    '[[rows]]\nedge = "base"\ncount = 64\nturns = false\nprofile = "lambertian"\n'
    'diameter = { value = 0.05, unit = "mm", source = "a" }\n'
    'gap = { value = 0.6, unit = "mm", source = "a" }\n'
    'height = { value = 2.0, unit = "mm", source = "a" }\n'
)


def refusal(folder: Path, text: str) -> str:
    (folder / "scene.toml").write_text(text)
    with pytest.raises(SceneError) as caught:
        load_scene(folder / "scene.toml")
    return str(caught.value).partition("scene.toml ")[2]


def finger(*changes: tuple[str, str]) -> str:
    text = scene_text("finger20").replace("schema = 1", "schema = 2")
    for pattern, new in changes:
        text, count = re.subn(pattern, lambda _, new=new: new, text)  # type: ignore[misc]
        assert count == 1
    return text


def test_tables_too_deep_in_each_other_are_one_sentence(tmp_path: Path) -> None:
    for text in (f"[{'.'.join('a' * 1500)}]\n", f"a = {'[' * 900}{']' * 900}\n"):
        assert refusal(tmp_path, text + finger()) == (
            "cannot be read as TOML: its tables and lists lie more than 50 deep in each other"
        )


def test_lists_without_an_end_are_named_with_their_limit(tmp_path: Path) -> None:
    many = ", ".join(f"{k / 200:.4f}" for k in range(15_000))
    said = refusal(tmp_path, finger((r"(?<=value = \[)0\.0, 45\.0, 90\.0", many)))
    assert said == (
        "is not a valid scene: bending.angles.value has 15000 entries, allowed: at most 512"
    )
    for part, name in ((LAMP, "lamps"), (ROW, "rows"), ("[[states]]\n", "states")):
        said = refusal(tmp_path, finger() + part * 513)
        assert f"{name} has 513 entries, allowed: at most 512" in said
    said = refusal(tmp_path, finger() + "".join(f"key{k} = 1\n" for k in range(600)))
    assert "baseline has 603 entries, allowed: at most 512" in said


def test_a_file_of_too_many_lamps_is_named_with_its_limit(tmp_path: Path) -> None:
    header = "x,y,z,direction_x,direction_y,direction_z,diameter,sigma_v\n"
    (tmp_path / "lamps.csv").write_text(header + "0,-19,-3,0,1,1,1,20\n" * 513)
    said = refusal(tmp_path, 'lamps_file = "lamps.csv"\n' + finger())
    assert "lamps_file = lamps.csv: has 513 lamps, allowed: at most 512" in said


def test_rows_of_too_many_lamps_are_named_with_their_limit(tmp_path: Path) -> None:
    fibers = scene_text("finger20").partition("[fibers]")[2].partition("[camera]")[0]
    text = finger((re.escape(f"[fibers]{fibers}"), "")).partition("[baseline]")[0]
    said = refusal(tmp_path, text + '[baseline]\nbase = "red"\n' + ROW * 17)
    assert "there are 1088 lamps, allowed: at most 1024" in said
