"""`Scene.with_`: what an edit of the file would give, its hash, and what it is refused for."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from render.errors import SceneError
from render.scene import load_scene, scene_text
from tests.oracles.soft_domes import moved_body, scene_text_of, write_files

NEWER = ("schema = 1", "schema = 2")
BENDS = "angles = { value = [0.0, 45.0, 90.0]"
GLOSS = 'specular = { value = 0.2, source = "x" }\nroughness = { value = 0.3, source = "x" }'
TOLERANCE = '{ distribution = "normal", deviation = 0.1, unit = "relative", source = "x" }'

Texts = tuple[tuple[str, str], ...]


def edited(base: str, texts: Texts, folder: Path) -> Path:
    """Return the file of a shipped scene with other texts in it."""
    text = scene_text(base)
    for old, new in texts:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "edited.toml"
    path.write_text(text)
    return path


def mm(old: float, new: object, key: str = "thickness") -> tuple[str, str]:
    return f"{key} = {{ value = {old}, ", f"{key} = {{ value = {new}, "


EDITS: dict[str, tuple[str, Texts, dict[str, Any]]] = {
    "a length": ("finger20", (mm(4.0, 5.0),), {"pad_thickness": 5.0}),
    "its path": ("finger20", (mm(4.0, 5.0),), {"pad.thickness": 5.0}),
    "its table": ("finger20", (mm(4.0, 5.0),), {"pad": {"thickness": 5}}),
    "as the file has it": (
        "finger20", (mm(4.0, 5.0),),
        {"pad_thickness": {"value": 5.0, "unit": "mm", "source": "drawing"}},
    ),
    "an angle": ("finger20", (mm(10.0, 7.3, "tilt"),), {"fibers_tilt": 7.3}),
    "a coordinate with an underscore": (
        "finger20", (mm(0.0, 0.25, "centre_x"),), {"sites_centre_x": np.float64(0.25)},
    ),
    "bends": (
        "finger20", ((BENDS, "angles = { value = [0, 12.7]"),),
        {"bending_angles": np.array([0.0, 12.7])},
    ),
    "a count": ("finger20", (("columns = 360", "columns = 300"),), {"camera_columns": 300}),
    "several": (
        "finger20", (mm(4.0, 5.0), ("columns = 360", "columns = 300")),
        {"pad_thickness": 5.0, "camera.columns": 300},
    ),
    "a name": ("finger20", (('"finger20"', '"other"'),), {"name": "other"}),
    "a newer key": (
        "finger20", (NEWER, ("[coating]", f"[coating]\n{GLOSS}")),
        {"schema": 2, "coating": {"specular": 0.2, "roughness": 0.3}},
    ),
    "a tolerance": (
        "finger20", (("[baseline]", f"[tolerances]\nled_power = {TOLERANCE}\n\n[baseline]"),),
        {"tolerances_led_power": {"distribution": "normal", "deviation": 0.1, "unit": "relative",
                                  "source": "x"}},
    ),
    "a list": (
        "finger20",
        (("[baseline]", '[[constraints.fixed]]\nfiber = 2\ncolor = "red"\n\n[baseline]'),),
        {"constraints_fixed": [{"fiber": 2, "color": "red"}]},
    ),
    "in a list": ("gelsight-mini", (mm(0.2, 0.7, "gap"),), {"rows.0.gap": 0.7}),
    "a profile": (
        "gelsight-mini",
        (('profile = "lambertian"', 'profile = { sigma_v = { value = 20.0, unit = "deg", '
          'source = "x" } }'),),
        {"rows_0_profile": {"sigma_v": 20.0}},
    ),
    "within a profile": (
        "gelsight-mini",
        (('profile = "lambertian"', 'profile = { sigma_v = { value = 20.0, unit = "deg", '
          'source = "x" } }'),),
        {"rows.0.profile.sigma_v": 20.0},
    ),
}  # fmt: skip
"""Base, what is replaced in its text, and the same as `Scene.with_` takes it."""


@pytest.mark.parametrize("name", EDITS)
def test_a_changed_scene_is_that_of_the_file_with_the_edit(name: str, tmp_path: Path) -> None:
    base, texts, changes = EDITS[name]
    wanted, found = load_scene(edited(base, texts, tmp_path)), load_scene(base).with_(**changes)
    assert found == wanted
    assert found.hash == wanted.hash
    assert found.name == wanted.name


WRONG: dict[str, tuple[str, Texts, dict[str, Any]]] = {
    "below the range": ("finger20", (mm(4.0, -3),), {"pad_thickness": -3}),
    "not a number": ("finger20", (mm(4.0, "nan"),), {"pad_thickness": float("nan")}),
    "a text": ("finger20", (mm(4.0, '"4 mm"'),), {"pad.thickness": "4 mm"}),
    "true": ("finger20", (mm(4.0, "true"),), {"pad_thickness": True}),
    "another unit": (
        "finger20", (('thickness = { value = 4.0, unit = "mm"', 'thickness = { value = 4.0, '
                      'unit = "cm"'),),
        {"pad.thickness.unit": "cm"},
    ),
    "a misspelled key": ("finger20", (("[pad]", "[pad]\nthicknes = 3"),), {"pad_thicknes": 3}),
    "an unknown key": ("finger20", (("schema = 1", "schema = 1\nfoo_bar = 3"),), {"foo_bar": 3}),
    "an unknown table": (
        "finger20", (("schema = 1", "schema = 1\nfoo.bar = 3"),), {"foo.bar": 3}),
    "a missing key": ("finger20", (("left = 8\n", ""),), {"fibers_left": None}),
    "what does not fit": ("finger20", (mm(18.0, 5.0, "width"),), {"pad_width": 5.0}),
    "two of them": (
        "finger20", (mm(4.0, -3), ("columns = 360", "columns = 4")),
        {"pad_thickness": -3, "camera_columns": 4},
    ),
    "a key of schema 2": (
        "finger20", (("[coating]", f"[coating]\n{GLOSS}"),),
        {"coating": {"specular": 0.2, "roughness": 0.3}},
    ),
    "one value for a list": (
        "finger20", (("value = [0.0, 45.0, 90.0]", "value = 30"),), {"bending_angles": 30}),
    "in a list": ("gelsight-mini", (mm(0.2, 700.0, "gap"),), {"rows.0.gap": 700.0}),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_change_is_refused_as_the_file_with_the_edit_would_be(
    name: str, tmp_path: Path
) -> None:
    base, texts, changes = WRONG[name]
    with pytest.raises(SceneError) as in_file:
        load_scene(edited(base, texts, tmp_path))
    with pytest.raises(SceneError) as changed:
        load_scene(base).with_(**changes)
    valid = " is not a valid scene: "
    assert str(changed.value) == f"{base} as changed{valid}{str(in_file.value).split(valid)[1]}"
    assert changed.value.field == in_file.value.field


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"rows.7.gap": 1.0}, "rows.7 is no entry of a list, allowed: rows.0 to rows.2"),
        ({"rows_gap": 1.0}, "rows.gap is no entry of a list"),
        ({"name.first": "x"}, "name is no table"),
        ({"pad": load_scene("digit").pad}, "pad = a Pad, allowed: values as the file has them"),
    ],
)
def test_what_no_file_could_say_is_one_sentence(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence):
        load_scene("gelsight-mini").with_(**changes)


def test_changes_add_up_and_leave_the_first_scene_as_it_was() -> None:
    scene = load_scene("finger20")
    twice = scene.with_(pad_thickness=5.0).with_(camera_columns=300)
    assert twice == scene.with_(pad_thickness=5.0, camera_columns=300)
    assert scene.with_() == scene == load_scene("finger20")
    for copied in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene)), scene.model_copy()):
        assert copied.with_(pad_thickness=5.0, camera_columns=300) == twice


def test_meshes_are_read_again_so_that_states_follow_another_rest(tmp_path: Path) -> None:
    write_files(tmp_path, steps=16)
    moved_body("low", 16).export(tmp_path / "again.stl")
    (tmp_path / "dome.toml").write_text(scene_text_of("pressed"))
    scene = load_scene(tmp_path / "dome.toml")
    text = scene_text_of("pressed").replace("rest.stl", "again.stl")
    (tmp_path / "again.toml").write_text(text)
    changed = scene.with_(skin_mesh_file="again.stl")
    assert changed.hash == load_scene(tmp_path / "again.toml").hash != scene.hash
    with pytest.raises(SceneError, match=r"none\.stl"):
        scene.with_(skin_mesh_file=tmp_path / "none.stl")


def test_lamps_of_a_file_can_be_changed_one_by_one_or_by_another_file(tmp_path: Path) -> None:
    head = "x,y,z,direction_x,direction_y,direction_z,diameter,sigma_v\n"
    (tmp_path / "one.csv").write_text(head + "0,0,-5,0,0,1,1,20\n")
    (tmp_path / "two.csv").write_text(head + "0,0,-5,0,0,1,2,20\n")
    texts = (
        ("schema = 1", 'schema = 2\nlamps_file = "one.csv"'),
        ('right = "green"', 'right = "green"\nlamps = ["red"]'),
    )
    scene = load_scene(edited("finger20", texts, tmp_path))
    other = scene.with_(lamps_file="two.csv")
    assert other.lamps is not None
    assert other.lamps[0].diameter == 2.0
    assert scene.with_(lamps_0_diameter=2.0) == other


def test_a_scene_made_in_memory_says_that_its_origin_can_be_changed() -> None:
    with pytest.raises(SceneError, match="finger20 was made in memory from another scene"):
        load_scene("finger20").with_sigma_v(2.0).with_(pad_thickness=5.0)


@pytest.mark.parametrize(
    ("part", "update", "sentence"),
    [
        ("", {"foo": 3}, "unknown key foo of Scene"),
        ("pad", {"thickness": -3.0}, "thickness of Pad = -3.0, allowed: 0.01 to 1000 mm"),
        ("pad", {"thickness": "4"}, 'thickness of Pad = "4", allowed: a number'),
        ("pad", {"thicknes": 4.0}, "unknown key thicknes of Pad, allowed: width, length"),
        ("camera", {"field_of_view": 110.0}, "field_of_view of Camera = 6302.5.*1 to 300 deg"),
        ("camera", {"columns": 2.5}, "columns of Camera = 2.5, allowed: a whole number"),
        ("", {"pad": 3}, "pad of Scene = 3, allowed: a table"),
        ("", {"pad": load_scene("digit").pad.model_copy(update={"width": 3.0})}, "the pyramids"),
    ],
)
def test_a_copy_is_checked_as_a_file_is(part: str, update: dict[str, Any], sentence: str) -> None:
    scene = load_scene("finger20")
    with pytest.raises(SceneError, match=sentence):
        (getattr(scene, part) if part else scene).model_copy(update=update)


@pytest.mark.parametrize("name", ["finger20", "gelsight-mini", "digit-dome"])
def test_every_value_of_a_scene_may_be_put_back_into_a_copy(name: str) -> None:
    scene = load_scene(name)
    for part in (scene, scene.pad, scene.camera, scene.coating, scene.bending, scene.baseline):
        content = {key: getattr(part, key) for key in type(part).model_fields}
        assert part.model_copy(update=content) == part


def test_a_scene_is_one_line_however_large_its_parts_are(tmp_path: Path) -> None:
    write_files(tmp_path, steps=16)
    (tmp_path / "dome.toml").write_text(scene_text_of("pressed"))
    for scene in (load_scene("finger20"), load_scene(tmp_path / "dome.toml")):
        for part in (scene, scene.pad, scene.skin, scene.camera, scene.states):
            assert "\n" not in repr(part)
            assert len(repr(part)) < 400
        assert scene.name in str(scene)
        assert scene.hash in str(scene)
        assert "<img" in scene._repr_html_()


def test_completion_of_a_scene_and_its_parts_shows_what_is_ours_alone() -> None:
    scene = load_scene("finger20")
    for part in (scene, scene.pad):
        shown = {name for name in dir(part) if not name.startswith("_")}
        assert set(type(part).model_fields) <= shown
        assert not [name for name in shown if name.startswith("model_") or name in ("json", "copy")]
    assert {"with_", "hash", "lamp_count"} <= set(dir(scene))
