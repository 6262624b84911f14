"""The scene file: what a sensor is made of, read from TOML and validated strictly.

Files hold lengths in mm, angles in degrees and coefficients in 1/mm, each with its unit and the
source of the value. In memory lengths are mm, angles radians and coefficients 1/mm, all float64.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import tomllib
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from render.errors import SceneError
from render.scene.constraints import Constraints
from render.scene.free_ranges import FreeRanges
from render.scene.quantities import Count, Part, Quantity
from render.scene.tolerances import Tolerances

Edge = Literal["left", "tip", "right"]
Color = Literal["red", "green", "blue"]
EDGES: tuple[Edge, ...] = ("left", "tip", "right")
COLORS: tuple[Color, ...] = ("red", "green", "blue")

Millimeters = Annotated[float, Quantity("mm", 0.01, 1000.0)]
Coordinate = Annotated[float, Quantity("mm", -1000.0, 1000.0)]


class Pad(Part):
    """The clear silicone pad: ``width`` along x, ``length`` along y, ``thickness`` along z."""

    width: Millimeters
    length: Millimeters
    thickness: Millimeters
    index: Annotated[float, Quantity("", 1.0, 1.7)]
    roughness: Annotated[float, Quantity("", 0.0, 0.5)]


class Diffuser(Part):
    """The scattering layer on the lit edges, index-matched to the pad (Henyey-Greenstein)."""

    thickness: Millimeters
    sigma_s: Annotated[float, Quantity("1/mm", 0.0, 50.0)]
    sigma_a: Annotated[float, Quantity("1/mm", 0.0, 10.0)]
    g: Annotated[float, Quantity("", -0.99, 0.99)]

    @property
    def free_values(self) -> dict[str, float]:
        """What a scene may leave free: reduced scattering in 1/mm and thickness in mm."""
        return {
            "reduced_scattering": self.sigma_s * (1.0 - self.g),
            "diffuser_thickness": self.thickness,
        }

    def with_free(self, name: str, value: float) -> Diffuser:
        """Return the layer with another value of a free quantity; g stays."""
        if name == "reduced_scattering":
            return self.model_copy(update={"sigma_s": value / (1.0 - self.g)})
        return self.model_copy(update={"thickness": value})


class Coating(Part):
    """The Lambertian far side of the pad, seen from inside."""

    albedo: Annotated[float, Quantity("", 0.0, 1.0)]


class Fibers(Part):
    """Fiber ends, evenly spaced per edge; Gaussian radiance profile (thesis 3.3.1).

    ``height`` is the distance of the fiber axis from the camera-side face; ``gap`` the air between
    fiber end and diffuser; ``tilt`` the fixed angle towards the coating.
    """

    left: Annotated[int, Count(0, 64)]
    tip: Annotated[int, Count(0, 64)]
    right: Annotated[int, Count(0, 64)]
    diameter: Annotated[float, Quantity("mm", 0.05, 5.0)]
    gap: Annotated[float, Quantity("mm", 0.05, 10.0)]
    height: Annotated[float, Quantity("mm", 0.0, 100.0)]
    sigma_v: Annotated[float, Quantity("deg", 0.1, 89.0)]
    tilt: Annotated[float, Quantity("deg", -60.0, 60.0)]

    @property
    def count(self) -> int:
        """Number of fibers on all edges."""
        return self.left + self.tip + self.right


class Camera(Part):
    """A pinhole in air below the pad, looking at the coating (+z), image up towards the tip."""

    distance: Millimeters
    y: Coordinate
    field_of_view: Annotated[float, Quantity("deg", 1.0, 175.0)]
    columns: Annotated[int, Count(8, 4096)]
    rows: Annotated[int, Count(8, 4096)]


class Bending(Part):
    """The total bending angles that are tested; the pad is a circular arc."""

    angles: Annotated[tuple[float, ...], Quantity("deg", 0.0, 180.0, many=True)]


class Sites(Part):
    """The grid of test contacts on the coating: ``columns`` across x, ``rows`` along y."""

    columns: Annotated[int, Count(1, 32)]
    rows: Annotated[int, Count(1, 64)]
    spacing: Millimeters
    centre_x: Coordinate
    centre_y: Coordinate

    @property
    def count(self) -> int:
        """Number of sites."""
        return self.columns * self.rows


class Indenter(Part):
    """The pyramid that is pressed into the coating at every site (thesis 4.2)."""

    faces: Annotated[int, Count(3, 64)]
    slope: Annotated[float, Quantity("deg", 1.0, 80.0)]
    radius: Annotated[float, Quantity("mm", 0.05, 10.0)]

    @property
    def clearance(self) -> float:
        """Half the side (mm) of the square around a pyramid that no other may enter."""
        return 1.5 * self.radius

    @property
    def depth(self) -> float:
        """Height of the pyramid in mm: how deep its apex is pressed below the coating."""
        return self.radius * math.cos(math.pi / self.faces) * math.tan(self.slope)


class Baseline(Part):
    """The color of every edge in the design that others are compared with (thesis 5.1)."""

    left: Color
    tip: Color
    right: Color


class Scene(Part):
    """One sensor, completely: what every level of the fidelity ladder is built from."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")]
    pad: Pad
    diffuser: Diffuser | None = None
    coating: Coating
    fibers: Fibers
    camera: Camera
    bending: Bending
    sites: Sites
    indenter: Indenter
    baseline: Baseline
    constraints: Constraints | None = None
    tolerances: Tolerances | None = None
    free: FreeRanges | None = None

    @model_validator(mode="after")
    def _parts_fit_together(self) -> Scene:
        problems = []
        if self.fibers.count == 0:
            problems.append("fibers: left, tip and right are all 0, at least one fiber is needed")
        if self.fibers.height > self.pad.thickness:
            problems.append(
                f"fibers.height = {self.fibers.height:g} mm lies above the pad, "
                f"allowed: 0 to pad.thickness = {self.pad.thickness:g} mm"
            )
        if self.fibers.diameter / 2 >= self.fibers.gap:
            problems.append(
                f"fibers.diameter = {self.fibers.diameter:g} mm cuts into the diffuser when the "
                f"fiber turns, allowed: below 2 fibers.gap = {2 * self.fibers.gap:g} mm"
            )
        for edge in EDGES:
            side = self.pad.width if edge == "tip" else self.pad.length
            needed = getattr(self.fibers, edge) * self.fibers.diameter
            if needed > side:
                problems.append(
                    f"fibers.{edge} = {getattr(self.fibers, edge)} fibers need {needed:g} mm, "
                    f"allowed: at most the edge of {side:g} mm"
                )
        angles = self.bending.angles
        if any(b <= a for a, b in itertools.pairwise(angles)):
            shown = ", ".join(f"{math.degrees(angle):g}" for angle in angles)
            problems.append(f"bending.angles = {shown} deg, allowed: distinct and ascending")
        if self.indenter.depth >= self.pad.thickness:
            problems.append(
                f"indenter: the pyramid is {self.indenter.depth:g} mm deep, "
                f"allowed: below pad.thickness = {self.pad.thickness:g} mm"
            )
        sites, clearance = self.sites, self.indenter.clearance
        if sites.count > 1 and sites.spacing < 2 * clearance:
            problems.append(
                f"sites.spacing = {sites.spacing:g} mm lets pyramids overlap, "
                f"allowed: at least 3 indenter.radius = {2 * clearance:g} mm"
            )
        half_x = abs(sites.centre_x) + (sites.columns - 1) / 2 * sites.spacing + clearance
        half_y = abs(sites.centre_y) + (sites.rows - 1) / 2 * sites.spacing + clearance
        if half_x > self.pad.width / 2 or half_y > self.pad.length / 2:
            problems.append(
                f"sites: the pyramids reach {half_x:g} x {half_y:g} mm from the pad's center, "
                f"allowed: at most {self.pad.width / 2:g} x {self.pad.length / 2:g} mm"
            )
        if self.constraints is not None:
            problems += self.constraints.problems(self.fibers.count)
        if self.tolerances is not None and self.diffuser is None:
            for name in ("scattering", "diffuser_thickness"):
                if getattr(self.tolerances, name) is not None:
                    problems.append(f"tolerances.{name}: the scene has no diffuser, leave it out")
        if self.free is not None:
            problems += self.free.problems(self.diffuser.free_values if self.diffuser else {})
        if problems:
            raise ValueError("; ".join(problems))
        return self

    @property
    def hash(self) -> str:
        """16 hex digits that identify the physical content.

        Sources, the name, constraints, tolerances and free ranges change no light and have no part
        in it.
        """
        lightless = {"name", "constraints", "tolerances", "free"}
        content = self.model_dump(mode="json", exclude=lightless)
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def load_scene(name_or_path: str | Path) -> Scene:
    """Return the validated scene of a shipped name (``finger20``) or a TOML file.

    Raises:
        SceneError: names every problem at once, each with key, value and allowed range.
    """
    raw, origin = _read(name_or_path)
    try:
        return Scene.model_validate(raw)
    except ValidationError as error:
        lines = [_sentence(problem) for problem in error.errors(include_url=False)]
        first = error.errors(include_url=False)[0]
        raise SceneError(
            f"{origin} is not a valid scene: " + "; ".join(lines),
            field=".".join(str(part) for part in first["loc"]),
            value=first.get("input"),
            allowed=str(first.get("ctx", {}).get("allowed", "")),
        ) from None


def sources(name_or_path: str | Path) -> dict[str, str]:
    """Return the source of every value of a scene file, keyed like ``pad.width``."""
    raw, _ = _read(name_or_path)
    by_key: dict[str, str] = {}
    for part, content in raw.items():
        if isinstance(content, dict):
            for key, quantity in content.items():
                if isinstance(quantity, dict) and "source" in quantity:
                    by_key[f"{part}.{key}"] = str(quantity["source"])
    return by_key


def shipped_scenes() -> list[str]:
    """Return the names of the scenes that come with tactilux."""
    folder = resources.files("render") / "scenes"
    return sorted(item.name[:-5] for item in folder.iterdir() if item.name.endswith(".toml"))


def scene_text(name_or_path: str | Path) -> str:
    """Return the TOML text of a shipped scene or a file, as it was written.

    Raises:
        SceneError: there is no such scene, or its file cannot be read.
    """
    text_name = str(name_or_path)
    if text_name in shipped_scenes():
        return (resources.files("render") / "scenes" / f"{text_name}.toml").read_text("utf-8")
    path = Path(name_or_path)
    try:
        return path.read_text(encoding="utf-8-sig")  # editors on Windows put a mark in front
    except FileNotFoundError:
        raise SceneError(
            f"there is no scene {text_name!r}: give the path of a TOML file or one of "
            f"{', '.join(shipped_scenes())}",
            field="scene",
            value=text_name,
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise _unreadable(text_name, error) from None


def _read(name_or_path: str | Path) -> tuple[dict[str, Any], str]:
    origin = str(name_or_path)
    try:
        return tomllib.loads(scene_text(name_or_path)), origin
    except tomllib.TOMLDecodeError as error:
        raise _unreadable(origin, error) from None


def _unreadable(origin: str, error: Exception) -> SceneError:
    return SceneError(f"{origin} cannot be read as TOML: {error}", field="scene", value=origin)


def _sentence(problem: Any) -> str:
    """Turn one validation problem into ``key = value: what is wrong and what is allowed``."""
    key = ".".join(str(part) for part in problem["loc"])
    kind = problem["type"]
    if kind == "extra_forbidden":
        return f"unknown key {key}"
    if kind == "missing":
        return f"missing key {key}"
    message = problem["msg"].removeprefix("Value error, ")
    if kind == "value_error" and not key:
        return str(message)
    value = problem["input"]
    if isinstance(value, dict) and "value" in value:
        unit = f" {value['unit']}" if "unit" in value else ""
        value = f"{value['value']}{unit}"
    return f"{key} = {value}: {message}"
