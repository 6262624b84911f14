"""Lamps that a CSV file lists, a line each, instead of the scene file itself.

What is wrong with a line is found where the rest of the scene is validated, so that all of it is
told at once; `LampLines` knows which line a lamp is from. A line that is no lamp stands in the list
as the `RefusedLamps` that says why, and so does a file that has none.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from render.scene.lamp_profile import ANGLES
from render.scene.quantities import MOST_LISTED
from render.small_table import SmallTable, TableRow, number

COLUMNS = ("x", "y", "z", "direction_x", "direction_y", "direction_z", "diameter")
CHOICES = (*ANGLES, "cosine_exponent", "profile")
"""Columns of which a file has one: deg, a number, or ``lambertian`` and names of profile files."""
TURNS = "turns"
"""Column that a file may have: ``true`` or ``false``, which nothing means too."""


UNITS = {"x": "mm", "y": "mm", "z": "mm", "diameter": "mm", **dict.fromkeys(ANGLES, "deg")}


@dataclass(frozen=True)
class RefusedLamps:
    """What stands in a scene in place of lamps that cannot be read: ``why``, and ``where``."""

    why: str
    where: str = "lamps_file"


@dataclass(frozen=True)
class LampLines:
    """The lamps of a file as a scene file would list them, and where each is from.

    Arguments:
        name: of the file, as the scene file has it.
        lines: number of each lamp's line, from 1.
        lamps: in the order of the lines.
    """

    name: str
    lines: tuple[int, ...]
    lamps: tuple[dict[str, Any] | RefusedLamps, ...]

    @staticmethod
    def read(folder: Path, name: str) -> LampLines:
        """Return the lamps of a file beside the scene in ``folder``.

        Columns, in any order: `COLUMNS` (mm; a direction of any length), one of `CHOICES`, and
        perhaps `TURNS`.

        Raises:
            ValueError: a phrase that says why the file lists no lamps.
        """
        table = SmallTable.read(folder / name)
        names = table.header
        if not table.rows:
            raise ValueError("has no lamps: give a header line and one line for each")
        if len(table.rows) > MOST_LISTED:
            raise ValueError(f"has {len(table.rows)} lamps, allowed: at most {MOST_LISTED}")
        if not names:
            raise ValueError(
                f"has no names of columns in its first line, allowed: {', '.join(COLUMNS)}, one of "
                f"{', '.join(CHOICES)}, and perhaps {TURNS}"
            )
        chosen = [choice for choice in CHOICES if choice in names]
        known = {*COLUMNS, *CHOICES, TURNS}
        if not set(COLUMNS) <= set(names) or len(chosen) != 1 or set(names) - known:
            raise ValueError(
                f"has the columns {', '.join(names)}, allowed: {', '.join(COLUMNS)}, one of "
                f"{', '.join(CHOICES)}, and perhaps {TURNS}"
            )
        if len(set(names)) < len(names):
            twice = next(column for column in names if names.count(column) > 1)
            raise ValueError(f"has the column {twice} twice, allowed: each once")
        table.check_units(UNITS)
        lamps = [
            _lamp_of_line(table, row, f"{name} line {row.line}", chosen[0]) for row in table.rows
        ]
        return LampLines(name, tuple(row.line for row in table.rows), tuple(lamps))

    def key(self, place: tuple[int | str, ...]) -> str:
        """Return line and column of a ``place`` in the scene: ``("lamps", 2, "diameter")``."""
        _, number, *inner = place
        line = f"{self.name} line {self.lines[int(number)]}"
        if not inner:
            return line
        column = str(inner[-1])
        if inner[0] in ("position", "direction"):
            first = 0 if inner[0] == "position" else 3
            column = COLUMNS[first + int(inner[1])] if len(inner) > 1 else str(inner[0])
        return f"{line}: {column}"

    def named(self, sentence: str) -> str:
        """Return a sentence in which lamps that it calls ``lamps.2`` are called by their lines."""

        def line_of(found: re.Match[str]) -> str:
            inner = (found[2],) if found[2] else ()
            return self.key(("lamps", int(found[1]), *inner))

        return re.sub(r"(?<![\w.])lamps\.(\d+)(?:\.(\w+))?", line_of, sentence)


def _lamp_of_line(
    table: SmallTable, cells: TableRow, where: str, choice: str
) -> dict[str, Any] | RefusedLamps:
    """Return the lamp of a line; what is no number stays a text, for validation to refuse."""
    if misfit := table.misfit(cells, optional=TURNS):
        return RefusedLamps(misfit, where)
    row = dict(zip(table.header, cells.cells, strict=False))

    def quantity(value: Any, unit: str = "") -> dict[str, Any]:
        return {"value": value, "source": where} | ({"unit": unit} if unit else {})

    def vector(first: int) -> list[float | str]:
        return [number(row[name]) for name in COLUMNS[first : first + 3]]

    turns = row.get(TURNS, "")
    if choice == "profile":
        profile = _named_profile(row[choice], where)
    else:
        profile = {choice: quantity(number(row[choice]), "deg" if choice in ANGLES else "")}
    return {
        "position": quantity(vector(0), "mm"),
        "direction": quantity(vector(3)),
        "diameter": quantity(number(row["diameter"]), "mm"),
        "profile": profile,
        "turns": {"true": True, "false": False, "": False}.get(turns.lower(), turns),
    }


def _named_profile(name: str, where: str) -> dict[str, Any]:
    if name == "lambertian":
        return {"cosine_exponent": {"value": 1.0, "source": where}}
    return {"file": name, "source": where}
