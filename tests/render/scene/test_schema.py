"""Scene files are validated strictly, and every problem is told at once."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from render.errors import SceneError
from render.scene import load_scene, shipped_scenes, sources
from render.scene.serialization import scene_content, scene_of

TEXT = (Path(__file__).parents[3] / "render" / "scenes" / "finger20.toml").read_text()
SCENE = load_scene("finger20")


def write(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write finger20 with some of its text replaced."""
    text = TEXT
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "scene.toml"
    path.write_text(text)
    return path


def refusal(folder: Path, *changes: tuple[str, str]) -> str:
    with pytest.raises(SceneError) as caught:
        load_scene(write(folder, *changes))
    return str(caught.value)


def test_finger20_is_the_sensor_of_the_thesis() -> None:
    assert "finger20" in shipped_scenes()
    assert SCENE.lamp_count == 20
    assert SCENE.sites.count == 15
    assert SCENE.indenter.faces == 10
    np.testing.assert_allclose(np.degrees(SCENE.bending.angles), [0, 45, 90])
    assert SCENE.diffuser is not None


def test_a_scene_is_read_from_any_path(tmp_path: Path) -> None:
    assert load_scene(write(tmp_path)) == SCENE
    assert load_scene(str(write(tmp_path))) == SCENE


def test_an_unknown_key_is_named(tmp_path: Path) -> None:
    assert "unknown key pad.color" in refusal(tmp_path, ("[pad]", '[pad]\ncolor = "red"'))
    assert "unknown key lens" in refusal(tmp_path, ("[pad]", "[lens]\nk = 1\n[pad]"))


def test_an_unknown_key_is_told_what_could_stand_there(tmp_path: Path) -> None:
    text = refusal(tmp_path, ("[coating]", "[coating]\ngloss = 1"), ("[sites]", "[sites]\nrow = 3"))
    assert "unknown key coating.gloss, allowed: albedo" in text
    assert "unknown key sites.row, did you mean rows?" in text
    text = refusal(tmp_path, ("[coating]", "[[colours]]\nname = 1\n[coating]"))
    assert "unknown key colours, did you mean colors, which needs schema = 2?" in text


def test_a_list_of_refused_entries_is_not_called_empty_too(tmp_path: Path) -> None:
    text = refusal(tmp_path, ("value = [0.0, 45.0, 90.0]", "value = [-15.0]"))
    assert "bending.angles.0 = -15.0: allowed: 0 to 180 deg" in text
    assert "at least 1 item" not in text
    assert "at least 1 item" in refusal(tmp_path, ("value = [0.0, 45.0, 90.0]", "value = []"))


def test_a_missing_key_is_named(tmp_path: Path) -> None:
    assert "missing key indenter.faces" in refusal(tmp_path, ("faces = 10\n", ""))


def test_a_value_out_of_range_comes_with_key_value_and_range(tmp_path: Path) -> None:
    text = refusal(tmp_path, ("value = 1.41", "value = 2.5"))
    assert "pad.index = 2.5: allowed: 1 to 1.7" in text
    text = refusal(tmp_path, ("value = 15.0", "value = 95.0"))
    assert "fibers.sigma_v = 95.0: allowed: 0.1 to 89 deg" in text
    text = refusal(tmp_path, ("left = 8", "left = 99"))
    assert "fibers.left = 99: allowed: 0 to 64" in text
    text = refusal(tmp_path, ("45.0, 90.0", "45.0, 190.0"))
    assert "bending.angles.2 = 190.0: allowed: 0 to 180 deg" in text


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_non_finite_values_are_refused(tmp_path: Path, value: str) -> None:
    text = refusal(tmp_path, ("value = 18.0", f"value = {value}"))
    assert f"pad.width = {value}: allowed: 0.01 to 1000 mm" in text


def test_a_wrong_unit_is_refused_with_the_value_that_was_given(tmp_path: Path) -> None:
    text = refusal(tmp_path, ('18.0, unit = "mm"', '1.8, unit = "cm"'))
    assert 'pad.width = 1.8 cm: unit must be "mm"' in text


def test_a_bare_number_is_told_the_form_it_must_have(tmp_path: Path) -> None:
    text = refusal(tmp_path, ('{ value = 0.6, source = "assumed" }', "0.6"))
    assert 'coating.albedo = 0.6: must have the form { value = ..., source = "..." }' in text


def test_several_problems_are_told_at_once(tmp_path: Path) -> None:
    text = refusal(
        tmp_path,
        ("value = 18.0", "value = -18.0"),
        ("tip = 4", "tip = 4.5"),
        ('left = "red"', 'left = "purple"'),
        ("schema = 1", "schema = 3"),
        ("[sites]", "[sites]\ndepth = 3"),
    )
    for key in ("pad.width = -18.0", "fibers.tip = 4.5", "baseline.left = purple", "schema = 3"):
        assert key in text
    assert "unknown key sites.depth" in text


def test_unknown_keys_and_colors_do_not_hide_what_is_wrong_with_the_geometry(
    tmp_path: Path,
) -> None:
    text = refusal(
        tmp_path,
        ("[sites]", "[sites]\ndepth = 3"),
        ('left = "red"', 'left = "purple"'),
        ("spacing = { value = 3.0", "spacing = { value = 1.0"),
    )
    for sentence in ("unknown key sites.depth", "baseline.left = purple", "pyramids overlap"):
        assert sentence in text


def test_an_edge_of_the_baseline_may_have_a_color_for_each_of_its_lamps(tmp_path: Path) -> None:
    mixed = ["red", "green", "green", "blue"]
    scene = load_scene(write(tmp_path, ('tip = "blue"', f"tip = {mixed}")))
    assert scene.baseline_colors() == ("red",) * 8 + tuple(mixed) + ("green",) * 8
    assert scene_of(scene_content(scene)).baseline_colors() == scene.baseline_colors()


def test_colors_of_a_baseline_are_of_the_palette_and_as_many_as_lamps(tmp_path: Path) -> None:
    for wrong, sentence in {
        '["red", "green", "blue"]': "baseline.tip names 3 colors, allowed: 4, one for each lamp",
        '["red", "pink", "red", "red"]': 'baseline.tip = ["red", "pink", "red", "red"]: allowed: ',
        '["red", "red", "red", 3]': "allowed: a color, or a list of one for each lamp of the edge",
        "[]": "baseline.tip names 0 colors, allowed: 4",
    }.items():
        assert sentence in refusal(tmp_path, ('tip = "blue"', f"tip = {wrong}"))


def test_the_error_names_field_value_and_allowed_range(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"width.* 5000.*allowed: 0\.01 to 1000 mm") as caught:
        load_scene(write(tmp_path, ("value = 18.0", "value = 5000.0")))
    assert caught.value.field == "pad.width"


def test_parts_that_do_not_fit_together_are_all_told(tmp_path: Path) -> None:
    text = refusal(
        tmp_path,
        ("value = 0.75, unit", "value = 0.9, unit"),
        (
            'value = 2.0, unit = "mm", source = "assumed: half',
            'value = 5.0, unit = "mm", source = "half',
        ),
        ('value = 30.0, unit = "deg"', 'value = 79.0, unit = "deg"'),
        ("value = 0.6, unit", "value = 1.5, unit"),
        ("45.0, 90.0", "90.0, 45.0"),
        ("[sites]\ncolumns = 3", "[sites]\ncolumns = 7"),
    )
    for part in (
        "fibers.diameter = 0.9 mm cuts",
        "fibers.height = 5 mm lies above",
        "mm deep, allowed: below pad.thickness = 4 mm",
        "sites.spacing = 3 mm lets pyramids overlap",
        "bending.angles = 0, 90, 45 deg, allowed: distinct and ascending",
        "sites: the pyramids reach",
    ):
        assert part in text


def test_fibers_must_exist_and_fit_on_their_edge(tmp_path: Path) -> None:
    none = [("left = 8", "left = 0"), ("tip = 4", "tip = 0"), ("right = 8", "right = 0")]
    assert "at least one fiber" in refusal(tmp_path, *none)
    text = refusal(tmp_path, ("left = 8", "left = 41"))
    assert "fibers.left = 41 fibers need 30.75 mm, allowed: at most the edge of 30 mm" in text


def test_a_scene_without_diffuser_declares_no_medium(tmp_path: Path) -> None:
    block = re.search(r"\[diffuser\].*?(?=\[coating\])", TEXT, re.DOTALL)
    assert block is not None
    scene = load_scene(write(tmp_path, (block.group(), "")))
    assert scene.diffuser is None
    assert scene.hash != SCENE.hash


def test_a_file_of_schema_2_that_says_what_schema_1_can_say_is_the_same_sensor(
    tmp_path: Path,
) -> None:
    newer = load_scene(write(tmp_path, ("schema = 1", "schema = 2")))
    assert newer.hash == SCENE.hash == "68471ad4c129ea4d"


def test_the_hash_of_a_clear_pad_is_that_of_schema_1(tmp_path: Path) -> None:
    block = re.search(r"\[diffuser\].*?(?=\[coating\])", TEXT, re.DOTALL)
    assert block is not None
    assert load_scene(write(tmp_path, (block.group(), ""))).hash == "f5d05fc768c16770"


def test_the_hash_ignores_name_sources_and_layout_of_the_file(tmp_path: Path) -> None:
    changed = write(
        tmp_path,
        ('name = "finger20"', 'name = "other"'),
        ('source = "assumed: clear silicone"', 'source = "measured"'),
        ("value = 18.0", "value = 18"),
        ("schema = 1", "# a comment\nschema = 1"),
    )
    assert load_scene(changed).hash == SCENE.hash
    assert re.fullmatch(r"[0-9a-f]{16}", SCENE.hash)


@pytest.mark.parametrize(
    "change",
    [
        ("value = 1.41", "value = 1.4100000000000001"),
        ("tip = 4", "tip = 5"),
        ("value = [0.0, 45.0, 90.0]", "value = [0.0, 45.0]"),
        ('tip = "blue"', 'tip = "green"'),
    ],
)
def test_the_hash_changes_with_any_content(tmp_path: Path, change: tuple[str, str]) -> None:
    assert load_scene(write(tmp_path, change)).hash != SCENE.hash


def test_sources_are_keyed_like_the_values() -> None:
    found = sources("finger20")
    assert found["fibers.diameter"] == "thesis 3.3.1"
    assert found["pad.width"] == "assumed"


def test_scenes_are_immutable() -> None:
    with pytest.raises(SceneError, match=r"width cannot be set to 3.0, .*scene.with_\("):
        SCENE.pad.width = 3.0
    with pytest.raises(SceneError, match=r"pad cannot be set .*scene.with_\("):
        SCENE.pad = SCENE.pad
    assert SCENE.pad.width == 18.0


def test_a_missing_scene_is_told_which_exist(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"no scene .*one of .*finger20"):
        load_scene(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"[pad", "cannot be read as TOML"),
        (b"\xff\xfe[", "is not text in UTF-8; give the path of a TOML file"),
        (b"pad = 3\npad = 4", "cannot be read as TOML"),
    ],
)
def test_a_file_that_is_not_toml_is_refused(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=said):
        load_scene(path)
    with pytest.raises(SceneError, match="cannot be read: Is a directory; give the path"):
        load_scene(tmp_path)


@given(st.text(max_size=200))
def test_no_text_can_crash_the_reader(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.getbasetemp() / "any.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SceneError):
        load_scene(path)
