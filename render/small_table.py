"""Small tables of text as people and their programs write them: CSV (RFC 4180) and its dialects.

Commas, semicolons, tabs or spaces separate; UTF-8, UTF-16 with its mark, or Windows-1252; capitals,
spaces and units in the names of columns; lines that begin with ``#``, ``sep=;``, empty rows and
columns. What may mean two things is refused with its cause.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from render.files import read_text

MOST_ROWS = 10_000
_NUMBER = re.compile(r"[+-]?([0-9]+[.,]?[0-9]*|[.,][0-9]+)([eE][+-]?[0-9]+)?|[+-]?(inf|nan)")
_THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2},[0-9]{3}")
"""What is a thousand and more to some, and a number of three decimals to others."""
_NAME = re.compile(r"(.*?)\s*(?:[\[(]\s*(.*?)\s*[\])]|/\s*(\S+)|_(mm|deg))?")
_UNITS = {"°": "deg", "degree": "deg", "degrees": "deg", "millimeter": "mm", "millimeters": "mm"}


@dataclass(frozen=True)
class TableRow:
    """Cells of a row without spaces around them, numbers with a point; ``line`` counts from 1."""

    line: int
    cells: tuple[str, ...]


@dataclass(frozen=True)
class SmallTable:
    """Rows that hold something, and names of their columns in lower case.

    ``header`` is () where the file names no columns; ``units`` are those that stand beside names,
    "" without.
    """

    separator: str
    header: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[TableRow, ...]

    @staticmethod
    def read(path: Path) -> SmallTable:
        """Return the table of a file.

        Raises:
            ValueError: a phrase that says why there is none, or what in it may mean two things.
        """
        lines = table_text(path).split("\n")
        given = re.fullmatch(r"sep=(.)\s*", lines[0].strip(' "'), re.IGNORECASE)
        lines[0] = "" if given else lines[0]
        lines, names_in_remark = _without_remarks(lines)
        full = [line for line in lines if line.strip()]
        if len(full) > MOST_ROWS:
            raise ValueError(f"has {len(full)} lines, allowed: up to {MOST_ROWS}")
        separator = given[1] if given else _separator(full)
        rows = list(_rows(lines, separator))
        named: tuple[str, ...] = ()
        if rows and not any(map(_NUMBER.fullmatch, rows[0].cells)):
            named = _trimmed(rows.pop(0).cells)
        elif rows:
            remark = [row.cells for row in _rows([names_in_remark], separator)]
            named = remark[0] if remark and len(remark[0]) == len(rows[0].cells) else ()
        _refuse_two_meanings([cell for row in rows for cell in row.cells])
        parts = [found.groups("") for name in named if (found := _NAME.fullmatch(name.lower()))]
        return SmallTable(
            separator,
            tuple(re.sub(r"[\s.-]+", "_", name) for name, *_ in parts),
            tuple(_UNITS.get(unit, unit) for unit in ("".join(given) for _, *given in parts)),
            tuple(
                TableRow(row.line, _with_points(_trimmed(row.cells, len(parts)))) for row in rows
            ),
        )

    def check_units(self, allowed: Mapping[str, str]) -> None:
        """Raise a ValueError of a column whose name bears another unit than the ``allowed`` one."""
        for name, unit in zip(self.header, self.units, strict=True):
            if unit and unit != allowed.get(name, unit):
                raise ValueError(f"has {name} in {unit}, allowed: {allowed[name]}")

    def misfit(self, row: TableRow, optional: str = "") -> str:
        """Return how a row lacks fields or has too many, "" where each column has one.

        The column ``optional`` may have none.
        """
        fields, width = len(row.cells), len(self.header)
        if fields > width:
            where = "; where commas are decimal, semicolons separate" * (self.separator == ",")
            return f" has {fields} fields, allowed: {width}, one for each column{where}"
        beyond = [name for name in self.header[fields:] if name != optional]
        if beyond:
            return f" ends before {', '.join(beyond)}, allowed: a field for each column"
        cells = zip(self.header, row.cells, strict=False)
        empty = [name for name, cell in cells if not cell and name != optional]
        if empty:
            return f" has nothing in {', '.join(empty)}, allowed: a value in each column"
        return ""


def table_text(path: Path) -> str:
    """Return the text of a file that a spreadsheet or an editor wrote, as `read_text` does."""
    text = read_text(path, ("utf-8-sig", "cp1252"))
    if "\0" in text:
        raise ValueError("is not text: save it as CSV")
    return text


def number(cell: str) -> float | str:
    """Return the number that a cell holds; the cell itself where it holds none.

    >>> number("2.5e1"), number("1_000")
    (25.0, '1_000')
    """
    return float(cell) if _NUMBER.fullmatch(cell.lower()) and "," not in cell else cell


def _without_remarks(lines: list[str]) -> tuple[list[str], str]:
    """Return the lines, those that begin with ``#`` empty, and the last of these above the rest.

    There `numpy.savetxt` names the columns.
    """
    are_remarks = [line.lstrip('" \t').startswith("#") for line in lines]
    last = ""
    for line, is_remark in zip(lines, are_remarks, strict=True):
        if is_remark:
            last = line.strip('" \t').lstrip("# ")
        elif line.strip():
            break
    kept = ["" if remark else line for line, remark in zip(lines, are_remarks, strict=True)]
    return kept, last


def _separator(lines: list[str]) -> str:
    """Return what separates the first line that begins with a number, or else the first.

    Spaces do between numbers, where every comma is decimal: not in ``1,photo 1 2.png``.
    """
    numbers = (line for line in lines if re.match(r'[\s"+-]*[.,]?[0-9]', line))
    first = next(numbers, lines[0] if lines else "")
    outside_quotes = re.sub(r'"[^"]*"', "", first)
    between_spaces = re.search(r"[0-9][ ]+[+-]?[.]?[0-9]", outside_quotes)
    with_commas = [part for part in outside_quotes.split() if "," in part]
    all_decimal = between_spaces and all(map(_NUMBER.fullmatch, with_commas))
    marks = "\t;" if all_decimal else "\t;,"
    return next((mark for mark in marks if mark in outside_quotes), " ")


def _rows(lines: list[str], separator: str) -> Iterator[TableRow]:
    if separator == " ":
        lines = [" ".join(line.split()) for line in lines]
    reader = csv.reader(
        (f"{line}\n" for line in lines), delimiter=separator, skipinitialspace=True, strict=True
    )
    try:
        for cells in reader:
            stripped = tuple(cell.strip() for cell in cells)
            if any(stripped):
                yield TableRow(reader.line_num, stripped)
    except csv.Error as error:
        raise ValueError(f"cannot be read from line {reader.line_num} on: {error}") from error


def _trimmed(cells: tuple[str, ...], width: int = 0) -> tuple[str, ...]:
    """Return the cells without the empty ones behind the last that is full, and behind width."""
    full = max((place + 1 for place, cell in enumerate(cells) if cell), default=0)
    return cells[: max(full, min(width, len(cells)))]


def _refuse_two_meanings(cells: list[str]) -> None:
    numbers = [cell for cell in cells if _NUMBER.fullmatch(cell)]
    commas = [cell for cell in numbers if "," in cell]
    points = [cell for cell in numbers if "." in cell]
    if commas and points:
        raise ValueError(f"has {points[0]} and {commas[0]}, allowed: one decimal mark")
    if commas and all(map(_THOUSANDS.fullmatch, commas)):
        raise ValueError(
            f"has {commas[0]}, which is read in two ways, allowed: "
            f"{commas[0].replace(',', '')} or {commas[0].replace(',', '.')}"
        )


def _with_points(cells: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(c.replace(",", ".") if _NUMBER.fullmatch(c) else c for c in cells)
