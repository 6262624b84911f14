"""A rotationally symmetric profile of measured luminous intensity: file and normalization.

A goniometer measures intensity ``I(theta)`` far from a lamp, relative to the axis of its beam. An
area ``A`` whose points all shine alike then has the radiance ``L(theta) = I(theta) / (A cos
theta)``. Between the angles of the file, intensity is linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from render.arrays import Array
from render.errors import RenderError
from render.ies_file import read_ies
from render.small_table import SmallTable, number, table_text

STEPS = 360
"""Of the table that directions are sampled from; each is a quarter of a degree."""


@dataclass(frozen=True)
class MeasuredProfile:
    """Intensity ``(angle,)`` in 1/sr of a lamp of unit power, over ``theta`` ``(angle,)`` in rad.

    ``theta`` rises from 0 and ends at pi/2 or before, beyond which nothing is emitted.
    """

    theta: Array
    intensity: Array

    @staticmethod
    def read(path: Path) -> MeasuredProfile:
        """Return the profile of a file, scaled to unit power.

        An IES file (`render.ies_file`), or a table (`render.small_table`) with an angle in degrees
        and an intensity in any unit on each line.

        Raises:
            RenderError: names the file and what is wrong in it.
        """
        is_ies = path.suffix.lower() == ".ies"
        try:
            content = table_text(path) if is_ies else SmallTable.read(path)
        except ValueError as error:
            raise _refused(path, f"it {error}") from error
        try:
            found = read_ies(content) if isinstance(content, str) else _columns(content)
        except ValueError as error:
            raise _refused(path, f"{error}") from error
        return MeasuredProfile._normalized(path, *found)

    @staticmethod
    def _normalized(path: Path, degrees: Array, intensity: Array) -> MeasuredProfile:
        if len(degrees) < 2 or not (np.diff(degrees) > 0).all():
            raise _refused(path, "its angles must rise, at least two of them")
        if not (np.isfinite(intensity).all() and (intensity >= 0).all()):
            raise _refused(path, "an intensity is negative or not finite")
        if degrees[0] != 0:
            raise _refused(path, f"its first angle is {degrees[0]:g} deg, allowed: 0")
        if intensity[degrees > 90].any():
            raise _refused(path, "it has intensity beyond 90 deg, which no flat face emits")
        end = np.interp(90.0, degrees, intensity)
        inside = degrees < 90
        degrees, intensity = degrees[inside], intensity[inside]
        if inside.all():
            last = min(90.0, degrees[-1] + 1e-3)
            degrees, intensity = np.append(degrees, last), np.append(intensity, 0.0)
        else:
            degrees, intensity = np.append(degrees, 90.0), np.append(intensity, end)
        theta = np.radians(degrees)
        power = _flux(theta, intensity, theta).sum()
        if not power > 0:
            raise _refused(path, "it is dark at every angle")
        return MeasuredProfile(theta, intensity / power)

    def step_flux(self) -> Array:
        """Return the power ``(STEPS,)`` that goes into each step of theta; they sum up to 1."""
        edges = np.linspace(0.0, np.pi / 2, STEPS + 1)
        theta = np.union1d(self.theta, edges)
        between = np.interp(theta, self.theta, self.intensity, right=0.0)
        cumulative = np.append(0.0, np.cumsum(_flux(theta, between, theta)))
        flux = np.diff(np.interp(edges, theta, cumulative))
        return np.asarray(flux / flux.sum())


def _flux(theta: Array, intensity: Array, edges: Array) -> Array:
    """Return 2 pi times the integral of linear intensity times sin theta between ``edges``."""
    low, high = edges[:-1], edges[1:]
    slope = np.diff(intensity) / np.diff(theta)
    start = intensity[:-1] - slope * low
    # The integral of theta sin theta is sin theta - theta cos theta.
    first = np.sin(high) - high * np.cos(high) - np.sin(low) + low * np.cos(low)
    return np.asarray(2 * np.pi * (start * (np.cos(low) - np.cos(high)) + slope * first))


def _columns(table: SmallTable) -> tuple[Array, Array]:
    if table.units[:1] not in ((), ("",), ("deg",)):
        raise ValueError(f"its angles are in {table.units[0]}, allowed: deg")
    pairs = []
    for row in table.rows:
        if len(row.cells) != 2:
            raise ValueError(
                "each line needs an angle in degrees and an intensity, not "
                f"{table.separator.join(row.cells)!r}"
            )
        pairs.append([number(cell) for cell in row.cells])
    for cell in (cell for pair in pairs for cell in pair):
        if isinstance(cell, str):
            raise ValueError(f"{cell!r} stands where a number belongs")
    angles, intensity = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
    return angles, intensity


def _refused(path: Path, why: str) -> RenderError:
    return RenderError(
        f"measured profile {path.name} cannot be used: {why}; give an .ies file or lines of "
        "an angle in degrees and an intensity",
        field="filename",
    )
