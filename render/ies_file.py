"""Luminous intensity of a lamp from an IES file: ANSI/IES LM-63 of 1986 to 2019, photometry C."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.small_table import number

ASYMMETRY_MAX = 0.1
"""Relative to the peak: how much the planes of a file may differ before they are refused."""
MOST_ANGLES = 10_000
PHOTOMETRY = {1.0: "C", 2.0: "B", 3.0: "A"}
VERTICAL_RANGES = ((0.0, 90.0), (90.0, 180.0), (0.0, 180.0))
HORIZONTAL_RANGES = ((0.0, 0.0), (0.0, 90.0), (0.0, 180.0), (0.0, 360.0), (90.0, 270.0))
"""First and last angles that the standard has, deg."""
WHOLE = f"a whole number of 1 to {MOST_ANGLES}"


def _whole(value: float) -> bool:
    return 1 <= value <= MOST_ANGLES and value.is_integer()


HEAD: tuple[tuple[str, Callable[[float], bool], str], ...] = (
    ("number of lamps", _whole, WHOLE),
    ("lumens per lamp", lambda v: v > 0 or v == -1, "above 0, or -1"),
    ("multiplier of candela", lambda v: v > 0, "above 0"),
    ("number of vertical angles", _whole, WHOLE),
    ("number of planes", _whole, WHOLE),
    ("photometric type", lambda v: v == 1, "1, which is C: planes through the axis"),
    ("type of units", lambda v: v in (1, 2), "1 (feet) or 2 (meters)"),
    ("width", lambda _: True, ""),
    ("length", lambda _: True, ""),
    ("height", lambda _: True, ""),
    ("ballast factor", lambda v: v > 0, "above 0"),
    ("number for future use", lambda _: True, ""),
    ("input watts", lambda v: v >= 0, "at least 0"),
)
"""Numbers before the angles, what each may be, and that in words."""


def read_ies(text: str) -> tuple[Array, Array]:
    """Return degrees from the beam's axis ``(angle,)``, rising, and candela ``(angle,)``.

    Planes are averaged over the whole turn. The axis is that of the half that shines, nadir or
    zenith. A tilt and the factor of a ballast change the power alone, and are passed over.

    Raises:
        ValueError: a phrase that says what is wrong, or is none of the standard's.
    """
    lines = text.rstrip("\x1a\n \t").split("\n")
    tilts = [k for k, line in enumerate(lines) if line.strip().upper().startswith("TILT=")]
    if not tilts:
        raise ValueError("it is no IES file: there is no line TILT=")
    tilt = lines[tilts[0]].strip()[len("TILT=") :].strip()
    if not tilt:
        raise ValueError("it says nothing behind TILT=, allowed: NONE, INCLUDE or a file's name")
    data = "\n".join(lines[tilts[0] + 1 :])
    found = re.search(r"(?<!\S)[+-]?[0-9]+,[0-9]+(?!\S)", data)
    if found:
        # The standard separates numbers by commas too: they are decimal if all fits then.
        try:
            _photometry(data.replace(",", "."), tilt)
        except ValueError:
            pass
        else:
            raise ValueError(f"it has decimal commas ({found[0]}), allowed: points")
    try:
        return _photometry(data.replace(",", " "), tilt)
    except ValueError as error:
        commas = f"; the comma of {found[0]} separates two numbers" if found else ""
        raise ValueError(f"{error}{commas}") from None


@dataclass
class _Numbers:
    """The numbers of a text, taken from its beginning."""

    words: list[str]
    at: int = 0

    def take(self, count: int, what: str) -> list[float]:
        """Return the next ``count`` numbers, of which ``what`` speaks."""
        words = self.words[self.at : self.at + count]
        if len(words) < count:
            raise ValueError(
                f"it ends too early and lacks {count - len(words)} of the {count} {what}"
            )
        self.at += count
        return [self._number(word) for word in words]

    @staticmethod
    def _number(word: str) -> float:
        value = number(word)
        if isinstance(value, str) or not math.isfinite(value):
            raise ValueError(f"{word!r} stands where a number belongs")
        return value


def _photometry(text: str, tilt: str) -> tuple[Array, Array]:
    numbers = _Numbers(text.split())
    if tilt.upper() == "INCLUDE":
        geometry, count = numbers.take(2, "numbers of the tilt")
        if geometry not in (1, 2, 3) or not _whole(count):
            raise ValueError(
                f"its tilt has the geometry {geometry:g} and {count:g} angles, allowed: 1, 2 or 3, "
                f"and {WHOLE}"
            )
        numbers.take(2 * int(count), "angles and factors of the tilt")
    head = numbers.take(len(HEAD), "numbers of the lamp that follow TILT")
    for (name, fits, allowed), value in zip(HEAD, head, strict=True):
        if not fits(value):
            known = PHOTOMETRY.get(value, "") if name == "photometric type" else ""
            which = f" ({known})" if known else ""
            raise ValueError(f"its {name} is {value:g}{which}, allowed: {allowed}")
    count, planes = int(head[3]), int(head[4])
    angles = np.array(numbers.take(count, "vertical angles"))
    turns = np.array(numbers.take(planes, "angles of planes"))
    what = f"intensities ({count} angles in {planes} plane{'s' * (planes != 1)})"
    candela = np.array(numbers.take(count * planes, what)).reshape(planes, count)
    if left := numbers.words[numbers.at :]:
        raise ValueError(
            f"it has {len(left)} value{'s' * (len(left) != 1)} behind its {count * planes} "
            f"intensities, the first is {left[0]!r}, allowed: none"
        )
    _check_angles("vertical angles", angles, VERTICAL_RANGES)
    _check_angles("angles of planes", turns, HORIZONTAL_RANGES)
    return _about_axis(angles, _mean_plane(turns, head[2] * candela))


def _check_angles(name: str, angles: Array, ranges: tuple[tuple[float, float], ...]) -> None:
    if (np.diff(angles) <= 0).any():
        raise ValueError(f"its {name} do not rise")
    if (angles[0], angles[-1]) not in ranges:
        allowed = ", ".join(f"{low:g} to {high:g}" for low, high in ranges if low < high)
        raise ValueError(
            f"its {name} go from {angles[0]:g} to {angles[-1]:g} deg, allowed: "
            f"{'0, ' * ((0.0, 0.0) in ranges)}{allowed}"
        )


def _mean_plane(turns: Array, candela: Array) -> Array:
    """Return the mean over the turn, planes ``(plane, angle)`` being linear between each other."""
    if np.ptp(candela, axis=0).max() > ASYMMETRY_MAX * candela.max():
        raise ValueError("its planes differ: only beams that are round about their axis are known")
    if len(turns) == 1:
        return np.asarray(candela[0])
    return np.asarray(np.trapezoid(candela, turns, axis=0) / (turns[-1] - turns[0]))


def _about_axis(angles: Array, candela: Array) -> tuple[Array, Array]:
    """Return angles from zenith where all light goes up, else as they are, from nadir."""
    if candela[angles < 90].any() or not candela[angles > 90].any():
        return angles, candela
    return 180.0 - angles[::-1], candela[::-1]
