"""A scene and the files it names are kept together, wherever those lay."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from optimize.design import SCENE, keep_scene
from render.errors import SceneError
from render.scene import load_scene, scene_text, sources, standalone

LAMPS = """x,y,z,direction_x,direction_y,direction_z,diameter,profile
-6,-3,-4,1,0.5,2,1.5,{csv_profile}
3,8,-8,0,-1,3,1.5,lambertian
"""
TOML = """
[[rows]]
edge = "base"
count = 2
diameter = {{ value = 1.0, unit = "mm", source = "test" }}
gap = {{ value = 0.6, unit = "mm", source = "test" }}
height = {{ value = 2.0, unit = "mm", source = "test" }}
profile = {{ {toml_profile}, source = "goniometer" }}
"""


def written(folder: Path, lamps: str, toml_profile: str, csv_profile: str) -> Path:
    """Write finger20 with a row at the base and listed lamps, both with measured profiles."""
    folder.mkdir(parents=True)
    text = scene_text("finger20").replace("schema = 1", f'schema = 2\nlamps_file = "{lamps}"')
    start, end = text.index("[fibers]"), text.index("[camera]")
    text = text[:start] + TOML.format(toml_profile=toml_profile) + "\n" + text[end:]
    start = text.index("[baseline]")
    text = text[:start] + '[baseline]\nbase = "red"\nlamps = ["green", "blue"]\n'
    path = folder / "sensor.toml"
    path.write_text(text)
    named = toml_profile.partition("=")[2].strip().strip("\"'")
    for name, content in {
        lamps: LAMPS.format(csv_profile=csv_profile),
        named: "0,1\n40,0.5\n80,0\n",
        csv_profile: "0,1\n30,0.8\n80,0\n",
    }.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    return path


@pytest.mark.parametrize(
    ("lamps", "toml_profile", "csv_profile"),
    [
        ("lamps.csv", 'file = "led.csv"', "other.csv"),
        ("data/lamps.csv", "file = 'data/led.csv'", "data/led2.csv"),
        ("../lamps.csv", 'file="../profiles/led.csv"', "../others/led.csv"),
        ("../lamps.csv", 'file = "led.csv"', "{absolute}/led.csv"),
    ],
    ids=["beside", "below", "elsewhere", "absolute"],
)
def test_a_run_keeps_all_that_its_scene_names_and_is_read_again_alone(
    tmp_path: Path, lamps: str, toml_profile: str, csv_profile: str
) -> None:
    csv_profile = csv_profile.format(absolute=tmp_path / "absolute")
    path = written(tmp_path / "user" / "mine", lamps, toml_profile, csv_profile)
    scene = load_scene(path)
    keep_scene(tmp_path / "run", standalone(path))
    shutil.move(tmp_path / "run", tmp_path / "moved")
    for folder in ("user", "absolute"):
        shutil.rmtree(tmp_path / folder, ignore_errors=True)
    kept = load_scene(tmp_path / "moved" / SCENE)
    assert kept == scene
    assert kept.hash == scene.hash
    # A copy of the copy is the same, byte for byte.
    again = standalone(tmp_path / "moved" / SCENE)
    keep_scene(tmp_path / "third", again)
    third = standalone(tmp_path / "third" / SCENE)
    assert (third.text, third.files) == (again.text, again.files)


def test_names_beside_the_scene_leave_its_text_as_it_was_written(tmp_path: Path) -> None:
    path = written(tmp_path / "mine", "lamps.csv", 'file = "led.csv"', "other.csv")
    kept = standalone(path)
    assert kept.text == path.read_text()
    assert set(kept.files) == {"lamps.csv", "led.csv", "other.csv"}
    assert standalone("finger20").files == {}


def test_a_file_elsewhere_that_is_named_in_another_way_is_one_sentence(tmp_path: Path) -> None:
    path = written(tmp_path / "mine", "lamps.csv", '"file" = "../led.csv"', "other.csv")
    with pytest.raises(SceneError, match="lies outside of the scene's folder"):
        standalone(path)


def test_a_missing_file_is_told_before_anything_is_kept(tmp_path: Path) -> None:
    path = written(tmp_path / "mine", "lamps.csv", 'file = "led.csv"', "other.csv")
    (tmp_path / "mine" / "other.csv").unlink()
    with pytest.raises(SceneError, match=r"other\.csv cannot be used"):
        keep_scene(tmp_path / "run", standalone(path))
    assert not (tmp_path / "run").exists()


def test_a_file_that_is_edited_after_it_was_read_is_kept_as_it_was(tmp_path: Path) -> None:
    path = written(tmp_path / "mine", "lamps.csv", 'file = "led.csv"', "other.csv")
    text, scene, origins = path.read_text(), load_scene(path), sources(path)
    path.write_text(text.replace('base = "red"', 'base = "green"').replace("test", "changed"))
    kept = standalone(scene)
    assert kept.text == text
    assert sources(scene) == origins
    keep_scene(tmp_path / "run", kept)
    assert load_scene(tmp_path / "run" / SCENE) == scene


def test_a_scene_without_a_file_of_its_own_is_not_kept(tmp_path: Path) -> None:
    scene = load_scene("finger20").with_(**{"pad.thickness": 3.0})
    with pytest.raises(SceneError, match="finger20 as changed has no file"):
        standalone(scene)
