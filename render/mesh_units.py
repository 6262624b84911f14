"""Units that the numbers of a mesh file may be in; commands offer them without loading a mesh."""

from __future__ import annotations

from typing import Literal

Unit = Literal["mm", "cm", "m", "in", "um"]
UNITS: dict[Unit, float] = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "um": 1e-3}
"""Millimeters of each unit that a file may be in."""
NAMES: dict[str, Unit] = {
    "mm": "mm", "millimeter": "mm", "millimetre": "mm", "cm": "cm", "centimeter": "cm",
    "centimetre": "cm", "m": "m", "meter": "m", "metre": "m", "in": "in", "inch": "in",
    "inche": "in", "um": "um", "micrometer": "um", "micron": "um",
}  # fmt: skip
"""What remarks call them."""
