"""A rotationally symmetric profile of measured luminous intensity: file and normalization.

A goniometer measures intensity ``I(theta)`` far from a lamp, relative to the axis of its beam. An
area ``A`` whose points all shine alike then has the radiance ``L(theta) = I(theta) / (A cos
theta)``. Between the angles of the file, intensity is linear.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from render.arrays import Array
from render.errors import RenderError
from render.files import read_bytes

STEPS = 360
"""Of the table that directions are sampled from; each is a quarter of a degree."""
HEAD = 13
"""Numbers of an IES file before its angles."""
ASYMMETRY_MAX = 0.1
"""Relative to the peak: how much the planes of an IES file may differ before they are refused."""


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

        An IES file (LM-63), or a text file with an angle in degrees and an intensity in any unit
        on each line, separated by comma, semicolon or space, and a header line at most.

        Raises:
            RenderError: names the file and what is wrong in it.
        """
        try:
            text = read_bytes(path).decode("latin-1")
            degrees, intensity = _ies(text) if path.suffix.lower() == ".ies" else _columns(text)
        except OSError as error:
            raise _refused(path, f"{error.strerror}") from error
        except ValueError as error:
            raise _refused(path, f"{error}") from error
        return MeasuredProfile._normalized(path, degrees, intensity)

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


def _columns(text: str) -> tuple[Array, Array]:
    rows = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if rows and re.search("[a-zA-Z]{2}", rows[0]):
        rows = rows[1:]
    table = []
    for row in rows:
        numbers = _numbers(row.strip(), r"[,;\s]+")
        if len(numbers) != 2:
            raise ValueError(f"each line needs an angle in degrees and an intensity, not {row!r}")
        table.append(numbers)
    angles, intensity = np.array(table).reshape(-1, 2).T
    return angles, intensity


def _ies(text: str) -> tuple[Array, Array]:
    """Return degrees and candela of an IES file, as in ANSI/IES LM-63.

    After ``TILT=NONE`` come 13 numbers of the lamp, among them the factor of all intensities and
    how many angles and planes there are; then the angles, those of the planes, and the intensities,
    plane by plane.
    """
    _, found, rest = text.partition("TILT=")
    if not found or not rest.lstrip().upper().startswith("NONE"):
        raise ValueError("it is no IES file with TILT=NONE")
    numbers = _numbers(rest.partition("\n")[2].strip(), r"[,\s]+")
    if len(numbers) < HEAD:
        raise ValueError(
            f"it ends too early and has {len(numbers)} of the {HEAD} numbers of the lamp that "
            "follow TILT=NONE"
        )
    counts = numbers[3:5]
    if not all(count >= 1 and count.is_integer() for count in counts):
        raise ValueError(
            f"it has {counts[0]:g} angles in {counts[1]:g} planes, where both are whole numbers of "
            "at least 1"
        )
    vertical, planes = map(int, counts)
    end = HEAD + vertical + planes
    count = vertical * planes
    missing = end + count - len(numbers)
    if missing > count:
        raise ValueError(
            f"it ends too early and lacks {missing - count} of the {vertical + planes} angles "
            "before its intensities"
        )
    if missing > 0:
        raise ValueError(
            f"it ends too early and lacks {missing} of its {count} intensities ({vertical} angles "
            f"in {planes} plane{'s' * (planes != 1)})"
        )
    angles = np.array(numbers[HEAD : HEAD + vertical])
    candela = numbers[2] * np.array(numbers[end : end + count]).reshape(planes, vertical)
    if np.ptp(candela, axis=0).max() > ASYMMETRY_MAX * candela.max():
        raise ValueError("its planes differ: only beams that are round about their axis are known")
    return angles, candela.mean(axis=0)


def _numbers(text: str, separators: str) -> list[float]:
    """Return the numbers in a text."""
    words, numbers = [word for word in re.split(separators, text) if word], []
    for word in words:
        try:
            numbers.append(float(word))
        except ValueError:
            raise ValueError(f"{word!r} stands where a number belongs") from None
    return numbers


def _refused(path: Path, why: str) -> RenderError:
    return RenderError(
        f"measured profile {path.name} cannot be used: {why}; give an .ies file or lines of "
        "an angle in degrees and an intensity",
        field="filename",
    )
