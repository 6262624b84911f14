"""Lamps of a CSV file: what its lines mean, and what is told of lines that are no lamps."""

from __future__ import annotations

from pathlib import Path

import pytest

from render.describe import describe
from render.errors import SceneError
from render.scene import Profile, load_scene, scene_text, sources

HEADER = "x,y,z,direction_x,direction_y,direction_z,diameter,"
BASELINE = ('right = "green"', 'right = "green"\nlamps = ["red"]')


def rewritten(folder: Path, lamps: str | None, *changes: tuple[str, str]) -> Path:
    """Return the finger with a file of lamps, and other changes."""
    text = scene_text("finger20")
    for old, new in (("schema = 1", 'schema = 2\nlamps_file = "lamps.csv"'), *changes):
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "scene.toml"
    path.write_text(text)
    if lamps is not None:
        (folder / "lamps.csv").write_text(lamps)
    return path


def refusal(folder: Path, lamps: str | None, *changes: tuple[str, str]) -> str:
    path = rewritten(folder, lamps, *changes)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    return str(caught.value).partition("is not a valid scene: ")[2]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (HEADER + "sigma_v\n0,0,-5,0,0,1,oh,20\n",
         'lamps.csv line 2: diameter = "oh", allowed: a number'),
        (HEADER + "sigma_v\n0,0,-5,0,0,1,,20\n",
         "lamps.csv line 2 has nothing in diameter, allowed: a value in each column"),
        (HEADER + "sigma_v\n0,0,-5,0,0,1,1,20,7,7\n",
         "lamps.csv line 2 has 10 fields, allowed: 8, one for each column"),
        (HEADER + "sigma_v\n0,0,-5\n",
         "lamps.csv line 2 ends before direction_x, direction_y, direction_z, diameter, sigma_v, "
         "allowed: a field for each column"),
        (HEADER + "sigma_v\n0,0,-5,0,0,1,1,120\n",
         "lamps.csv line 2: sigma_v = 120.0: allowed: 0.1 to 89 deg"),
        (HEADER + "profile,turns\n0,0,-5,0,0,1,1,lambertian,maybe\n",
         'lamps.csv line 2: turns = "maybe", allowed: true or false'),
        (HEADER + "profile\n0,0,-5,0,0,1,1,none.ies\n",
         "lamps.csv line 2: profile = none.ies: measured profile none.ies cannot be used"),
        (HEADER + "profile\n0,0,-5,0,0,1,1,\n", "lamps.csv line 2 has nothing in profile"),
        ("x,y\n1,2\n", "lamps_file = lamps.csv: has the columns x, y, allowed: x, y, z"),
        ("", "lamps_file = lamps.csv: has no lamps"),
        (None, "lamps_file = lamps.csv: cannot be read"),
    ],
)  # fmt: skip
def test_what_is_no_lamp_is_told_with_its_line(
    tmp_path: Path, text: str | None, sentence: str
) -> None:
    assert refusal(tmp_path, text).startswith(sentence)


def test_all_bad_lines_are_told_at_once_and_with_all_else_that_is_wrong(tmp_path: Path) -> None:
    lines = "q,0,-5,0,w,1,1,20\n\n0,0,-5,0,0,1,1,20\n0,0,-5\n"
    said = refusal(
        tmp_path,
        HEADER + "sigma_v\n" + lines,
        ("thickness = { value = 4.0", "thickness = { value = -6.0"),
        ("columns = 360", "columns = 3"),
    )
    for sentence in (
        'lamps.csv line 2: x = "q", allowed: a number',
        'lamps.csv line 2: direction_y = "w", allowed: a number',
        "lamps.csv line 5 ends before direction_x",
        "pad.thickness = -6.0",
        "camera.columns = 3",
    ):
        assert sentence in said
    assert "line 4" not in said
    assert "pad.thickness = -6.0" in refusal(
        tmp_path, "x,y\n1,2\n", ("thickness = { value = 4.0", "thickness = { value = -6.0")
    )


def test_a_lamp_where_none_can_be_is_told_with_its_line(tmp_path: Path) -> None:
    lines = "0,-19,-3,0,1,1,1,20\n0,-19,40,0,1,1,1,20\n0,-19,-3,0,0,0,1,20\n"
    lamps = ('right = "green"', 'right = "green"\nlamps = ["red", "red", "red"]')
    said = refusal(tmp_path, HEADER + "sigma_v\n" + lines, lamps)
    assert said.startswith("lamps.csv line 4: direction = 0, 0, 0 points nowhere")
    said = refusal(tmp_path, HEADER + "sigma_v\n" + lines.replace("0,0,0,1", "0,0,1,1"), lamps)
    assert said.startswith("lamps.csv line 3 at z = 40 mm lies above the pad")
    assert "lamps.1" not in said


def test_it_stands_alone(tmp_path: Path) -> None:
    said = refusal(tmp_path, None, ("[pad]", "[[lamps]]\n[pad]"))
    assert said == "lamps_file: lamps are listed in this file too, allowed: one"
    said = refusal(tmp_path, None, ('"lamps.csv"', "5"))
    assert said == "lamps_file = 5, allowed: the name of a CSV file"


def test_a_file_of_lamps_says_the_same_as_a_list(tmp_path: Path) -> None:
    lamps = HEADER + "cosine_exponent\n0,-19,-3,0,1,1,1.5,4\n"
    path = rewritten(tmp_path, lamps, BASELINE)
    (lamp,) = load_scene(path).lamps or ()
    assert lamp.position == (0.0, -19.0, -3.0)
    assert lamp.profile == Profile.model_construct(cosine_exponent=4.0)
    assert load_scene(path).lamp_count == 21


def test_describe_names_the_line_of_each_lamp(tmp_path: Path) -> None:
    path = rewritten(tmp_path, HEADER + "profile\n\n0,-19,-3,0,1,1,1.5,lambertian\n", BASELINE)
    values = {one.key: one.source for one in describe(load_scene(path), sources(path)).values}
    for key in ("position", "direction", "diameter", "profile"):
        assert values[f"lamps.0.{key}"] == "lamps.csv line 3"


@pytest.mark.parametrize(
    "text",
    [
        "x;y;z;direction_x;direction_y;direction_z;diameter;cosine_exponent\r\n"
        "0;-19;-3;0;1;1;1,5;4\r\n;;;;;;;\r\n",
        "# by hand\nX [mm],Y [mm],Z [mm],Direction X,Direction Y,Direction Z,Diameter,"
        "Cosine Exponent,\n0,-19,-3,0,1,1,1.5,4,\n,,,,,,,,\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_file_of_a_spreadsheet_is_the_same_lamp(tmp_path: Path, text: str, encoding: str) -> None:
    path = rewritten(tmp_path, "", BASELINE)
    (tmp_path / "lamps.csv").write_bytes(text.encode(encoding))
    (lamp,) = load_scene(path).lamps or ()
    assert (lamp.position, lamp.diameter) == ((0.0, -19.0, -3.0), 1.5)
    assert lamp.profile.cosine_exponent == 4.0


def test_one_fault_of_many_lines_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "led.csv").write_text("0,1\n10,-1\n")
    lamps = HEADER + "profile\n" + "0,-19,-3,0,1,1,1.5,led.csv\n" * 7
    said = refusal(tmp_path, lamps)
    assert said.startswith(
        "lamps.csv line 2: profile, lamps.csv line 3: profile, lamps.csv line 4: profile and 4 more"
        " = led.csv: measured profile led.csv cannot be used: an intensity is negative"
    )
    assert said.count("led.csv cannot be used") == 1
    said = refusal(tmp_path, HEADER + "sigma_v\n" + "0,0,-19,0,-3,0,0,0,1,0,1,0,1,5,20,0\n" * 9)
    assert said.startswith(
        "lamps.csv line 2, lamps.csv line 3, lamps.csv line 4 and 6 more has 16 fields, allowed: 8"
    )
    assert "where commas are decimal, semicolons separate" in said
    assert said.count("fields") == 1


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("0,0,-5,0,0,1,1,20\n", "lamps_file = lamps.csv: has no names of columns"),
        (HEADER + "sigma_v,x\n0,0,-5,0,0,1,1,20,1\n", "lamps_file = lamps.csv: has the column x"),
        ("x [cm]" + HEADER[1:] + "sigma_v\n0,0,-5,0,0,1,1,20\n", "lamps_file = lamps.csv: has x"),
        (HEADER + "sigma_v\n0,0,-5,,,,,\n", "lamps.csv line 2 has nothing in direction_x"),
        (HEADER + "sigma_v\n,,,,,,,\n,,,,,,,\n", "lamps_file = lamps.csv: has no lamps"),
    ],
)  # fmt: skip
def test_a_table_that_lists_no_lamps_is_one_sentence(
    tmp_path: Path, text: str, sentence: str
) -> None:
    said = refusal(tmp_path, text)
    assert said.startswith(sentence)
    assert "; " not in said
