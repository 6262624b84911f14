"""Tables as people's programs write them: one content, or one sentence with the cause."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from render.small_table import MOST_ROWS, SmallTable

PLAIN = "x,diameter,profile\n-5.5,1.5,led.ies\n0.25,1.5,lambertian\n"
CELLS = (("-5.5", "1.5", "led.ies"), ("0.25", "1.5", "lambertian"))
GERMAN = "x;diameter;profile\n-5,5;1,5;led.ies\n0,25;1,5;lambertian\n"


def table(folder: Path, content: str | bytes) -> SmallTable:
    path = folder / "table.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return SmallTable.read(path)


def refusal(folder: Path, content: str | bytes) -> str:
    with pytest.raises(ValueError, match=r"(has|is|cannot) ") as caught:
        table(folder, content)
    return str(caught.value)


@pytest.mark.parametrize(
    "content",
    [
        PLAIN,
        PLAIN.replace("\n", "\r\n"),
        PLAIN.replace("\n", "\r"),
        PLAIN.encode("utf-8-sig"),
        PLAIN.encode("utf-16"),
        PLAIN.replace(",", "\t").encode("utf-16-be").join([b"\xfe\xff", b""]),
        GERMAN,
        GERMAN.replace(";", "\t"),
        GERMAN.replace(";", " "),
        f"sep=;\r\n{GERMAN}",
        f'"sep=;"\n{GERMAN}',
        "sep=|\n" + GERMAN.replace(";", "|"),
        PLAIN.replace(",", ", "),
        PLAIN.replace("\n", ",,,\n"),
        PLAIN.replace("\n", "\n,,,\n\n   \n"),
        f"# by hand, in 2024\n{PLAIN}",
        f'"# by hand, in 2024",,\n{PLAIN}# the end\n',
        PLAIN.replace("x,diameter,profile", "# x,diameter,profile"),
        PLAIN.replace("x,diameter,profile", " X , Diameter,PROFILE "),
        PLAIN.replace("x,diameter", "x [mm],Diameter (mm)"),
        PLAIN.replace("x,diameter", '"X / mm","diameter_mm"'),
        PLAIN.replace("-5.5,1.5,led.ies", '"-5.5","1.5","led.ies"'),
        'x,diameter,profile\n"-5,5","1,5","led.ies"\n"0,25","1,5",lambertian\n',
        PLAIN.rstrip("\n"),
    ],
)  # fmt: skip
def test_a_table_is_the_same_in_every_dialect(tmp_path: Path, content: str | bytes) -> None:
    found = table(tmp_path, content)
    assert found.header == ("x", "diameter", "profile")
    assert tuple(row.cells for row in found.rows) == CELLS
    found.check_units({"x": "mm", "diameter": "mm"})


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("name", ["photo 1 2.png", "1 2.png", "640 480"])
@pytest.mark.parametrize("first", [True, False])
def test_digits_between_spaces_in_a_cell_separate_nothing(
    tmp_path: Path, separator: str, name: str, first: bool
) -> None:
    cells = (name, "0.5", "led") if first else ("7", name, "led")
    path = tmp_path / "table.csv"
    path.write_text("\n".join(separator.join(row) for row in (("a", "b", "c"), cells, cells)))
    table = SmallTable.read(path)
    assert table.header == ("a", "b", "c")
    assert [row.cells for row in table.rows] == [cells, cells]


def test_rows_know_their_lines(tmp_path: Path) -> None:
    found = table(tmp_path, f"sep=,\n# remark\n{PLAIN}\n,,\n1,2,lambertian\n")
    assert [row.line for row in found.rows] == [4, 5, 8]


def test_what_numpy_writes_is_read(tmp_path: Path) -> None:
    numbers = np.array([[0.0, 1.5], [30.0, 1e-3]])
    for delimiter in (" ", ",", ";", "\t"):
        np.savetxt(
            tmp_path / "t.csv", numbers, delimiter=delimiter, header=f"angle{delimiter}intensity"
        )
        found = SmallTable.read(tmp_path / "t.csv")
        assert found.header == ("angle", "intensity")
        np.testing.assert_array_equal(np.array([r.cells for r in found.rows], float), numbers)


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        ("x;y\n1,5;2.5\n", "has 2.5 and 1,5, allowed: one decimal mark"),
        ("x;y\n1,250;2\n", "has 1,250, which is read in two ways, allowed: 1250 or 1.250"),
        ('x,y\n"1,5,2\n', "cannot be read from line 3 on"),
        (b"PK\x03\x04\x00\x00\x00", "is not text: save it as CSV"),
        (b"x,y\n\x81\x8d\n", "is not text in UTF-8"),
        ("0,1\n" * (MOST_ROWS + 1), f"has {MOST_ROWS + 1} lines, allowed: up to {MOST_ROWS}"),
    ],
)
def test_what_is_no_table_or_two_is_one_sentence(
    tmp_path: Path, content: str | bytes, cause: str
) -> None:
    assert cause in refusal(tmp_path, content)


def test_a_file_too_large_to_be_a_table_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "table.csv").open("wb") as stream:
        stream.truncate(10**11)
    with pytest.raises(ValueError, match="allowed: up to 4,000,000"):
        SmallTable.read(tmp_path / "table.csv")


def test_a_number_of_three_decimals_is_one_where_another_shows_the_mark(tmp_path: Path) -> None:
    found = table(tmp_path, "x;y\n1,250;2,5\n")
    assert found.rows[0].cells == ("1.250", "2.5")


def test_a_column_in_another_unit_is_named(tmp_path: Path) -> None:
    found = table(tmp_path, "x [cm];y\n1;2\n")
    with pytest.raises(ValueError, match="has x in cm, allowed: mm"):
        found.check_units({"x": "mm"})
    assert table(tmp_path, "Angle [°],I\n0,1\n".encode("cp1252")).units == ("deg", "")
