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
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from render.arrays import Array
from render.errors import SceneError
from render.scene.camera import Camera, Coordinate, Millimeters
from render.scene.colors import (
    DEFAULT_CHANNELS,
    OFF,
    RGB,
    LedColor,
    Palette,
    colors_in,
    palette_of,
)
from render.scene.constraints import Constraints
from render.scene.faces import (
    Finish,
    NamedFaces,
    face_problems,
    finishes,
    painted_lamp_problems,
)
from render.scene.free_ranges import FreeRanges
from render.scene.lamps import (
    EDGES,
    FACES,
    RIM_EDGES,
    Box,
    Edge,
    Fibers,
    ListedLamp,
    PlacedLamp,
    Row,
    lamps_of_file,
    listed_problems,
    placed_lamps,
    placement_problems,
    row_problems,
)
from render.scene.quantities import Count, Part, Quantity, keys_of_schema_2, since_schema_2
from render.scene.skin import Skin
from render.scene.skin_problems import skin_problems
from render.scene.tolerances import Tolerances


def _known_color(value: str, info: ValidationInfo) -> str:
    """Refuse a color that the file does not have; the context names those that it has."""
    known = (info.context or {}).get("colors", RGB.names)
    if value not in known:
        allowed = ", ".join(known)
        raise PydanticCustomError("unknown_color", "allowed: {allowed}", {"allowed": allowed})
    return value


KnownColor = Annotated[str, AfterValidator(_known_color)]


MIN_BONDED_INDEX = 1.2
"""Least index of a pad on a window: what has none is no pad that a plate is bonded to."""


class Pad(Part):
    """The clear silicone pad: ``width`` along x, ``length`` along y, ``thickness`` along z.

    ``roughness`` (Beckmann alpha) is that of all faces to the air but those that ``faces`` name.
    """

    width: Millimeters
    length: Millimeters
    thickness: Millimeters
    index: Annotated[float, Quantity("", 1.0, 1.7)]
    roughness: Annotated[float, Quantity("", 0.0, 0.5)]


class Diffuser(Part):
    """The scattering layer on edges of the pad, index-matched to it (Henyey-Greenstein).

    It lies ``on`` the edges that are named, and on left, tip and right where none is. Where two
    edges that have it meet, it goes round the corner.
    """

    on: Annotated[tuple[Edge, ...], Field(strict=False, min_length=1)] | None = since_schema_2()
    thickness: Millimeters
    sigma_s: Annotated[float, Quantity("1/mm", 0.0, 50.0)]
    sigma_a: Annotated[float, Quantity("1/mm", 0.0, 10.0)]
    g: Annotated[float, Quantity("", -0.99, 0.99)]

    @property
    def edges(self) -> tuple[Edge, ...]:
        """The edges that it lies on, in the order of `EDGES`."""
        return RIM_EDGES if self.on is None else tuple(edge for edge in EDGES if edge in self.on)

    def problems(self) -> Iterator[str]:
        """Yield what is wrong with it, one sentence each."""
        named = self.on or ()
        for edge in EDGES:
            if named.count(edge) > 1:
                shown = ", ".join(named)
                yield f"diffuser.on = {shown} names {edge} twice, allowed: each edge once"

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


class Window(Part):
    """A clear plate under the pad, bonded to its lower face and of its outline.

    It reaches from z = 0 down to -``thickness``, and the camera looks through it. The face
    ``lower`` is its lower one; its edges are finished as the pad's above them, and lamps with a
    height below 0 shine into them.
    """

    thickness: Millimeters
    index: Annotated[float, Quantity("", 1.2, 1.9)]


class Coating(Part):
    """The Lambertian far side of the pad, seen from inside."""

    albedo: Annotated[float, Quantity("", 0.0, 1.0)]


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

    @property
    def places(self) -> Array:
        """Flat x and y of the sites, ``(site, 2)`` mm, row by row from the base."""
        x = self.centre_x + (np.arange(self.columns) - (self.columns - 1) / 2) * self.spacing
        y = self.centre_y + (np.arange(self.rows) - (self.rows - 1) / 2) * self.spacing
        grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
        return np.stack([grid_x.ravel(), grid_y.ravel()], axis=-1)


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
    """The color of every edge in the design that others are compared with (thesis 5.1).

    ``lamps`` are the colors of listed lamps, one by one.
    """

    left: KnownColor | None = None
    tip: KnownColor | None = None
    right: KnownColor | None = None
    base: KnownColor | None = since_schema_2()
    lamps: Annotated[tuple[KnownColor, ...], Field(strict=False)] | None = since_schema_2()

    def problems(self, edges: set[str], listed: int, every_edge: bool) -> Iterator[str]:
        """Yield what is missing or too much for rows on ``edges`` and ``listed`` lamps."""
        needed = edges | {"left", "tip", "right"} if every_edge else edges
        for edge in EDGES:
            if edge in needed and getattr(self, edge) is None:
                yield f"missing key baseline.{edge}"
            elif edge not in needed and getattr(self, edge) is not None:
                yield f"baseline.{edge}: no row of lamps is on that edge, leave it out"
        if len(self.lamps or ()) != listed:
            yield (
                f"baseline.lamps names {len(self.lamps or ())} colors, allowed: {listed}, one for "
                "each listed lamp"
            )


class Scene(Part):
    """One sensor, completely: what every level of the fidelity ladder is built from."""

    schema_version: Annotated[Literal[1, 2], Field(alias="schema")]
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")]
    pad: Pad
    diffuser: Diffuser | None = None
    window: Window | None = since_schema_2()
    coating: Coating
    skin: Skin | None = since_schema_2()
    fibers: Fibers | None = None
    faces: tuple[NamedFaces, ...] | None = since_schema_2()
    rows: tuple[Row, ...] | None = since_schema_2()
    lamps: tuple[ListedLamp, ...] | None = since_schema_2()
    camera: Camera
    bending: Bending
    sites: Sites
    indenter: Indenter
    baseline: Baseline
    colors: Annotated[tuple[LedColor, ...], Field(strict=False, min_length=1)] | None = (
        since_schema_2()
    )
    constraints: Constraints | None = None
    tolerances: Tolerances | None = None
    free: FreeRanges | None = None

    @model_validator(mode="before")
    @classmethod
    def _lists_become_tuples(cls, raw: Any, info: ValidationInfo) -> Any:
        """Read the file of lamps; TOML has lists where parts are tuples."""
        if not isinstance(raw, dict):
            return raw
        raw = dict(raw)
        if "lamps_file" in raw:
            name, folder = raw.pop("lamps_file"), (info.context or {}).get("folder", Path())
            if "lamps" in raw:
                raise ValueError("lamps_file: lamps are listed in this file too, allowed: one")
            if not isinstance(name, str):
                raise ValueError(f"lamps_file = {name}, allowed: the name of a CSV file")
            try:
                raw["lamps"] = lamps_of_file(folder / name)
            except ValueError as error:
                raise ValueError(f"lamps_file = {name}: {error}") from error
        for key in ("faces", "rows", "lamps"):
            if isinstance(raw.get(key), list):
                raw[key] = tuple(raw[key])
        return raw

    @model_validator(mode="after")
    def _parts_fit_together(self) -> Scene:
        problems = []
        if self.schema_version == 1:
            problems += [f"{key} needs schema = 2" for key in keys_of_schema_2(self)]
            if self.constraints and any(one.color == OFF for one in self.constraints.fixed):
                problems.append(f"constraints.fixed: color = {OFF} needs schema = 2")
        problems += self.camera.problems()
        if self.diffuser is not None:
            problems += self.diffuser.problems()
        problems += face_problems(self.faces or (), self.diffuser_edges)
        problems += self._window_problems()
        problems += self._lamp_problems()
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
        if not problems:
            problems += skin_problems(self)
        palette = self.palette
        problems += palette.problems()
        if self.constraints is not None:
            problems += self.constraints.problems(palette, self.lamp_count)
        if self.tolerances is not None and self.tolerances.sigma_v is not None:
            parts: list[Row | ListedLamp] = [*self.lamp_rows, *(self.lamps or ())]
            if all(part.profile.sigma_v is None for part in parts):
                problems.append("tolerances.sigma_v: no lamp has a Gaussian profile, leave it out")
        for entry in self.constraints.fixed if self.constraints is not None else ():
            turning = self.turning
            if entry.angle is not None and not (*turning, True)[min(entry.fiber, len(turning))]:
                problems.append(
                    f"constraints.fixed: lamp {entry.fiber} does not turn, leave its angle out"
                )
        if self.tolerances is not None and self.diffuser is None:
            for name in ("scattering", "diffuser_thickness"):
                if getattr(self.tolerances, name) is not None:
                    problems.append(f"tolerances.{name}: the scene has no diffuser, leave it out")
        if self.free is not None:
            problems += self.free.problems(self.diffuser.free_values if self.diffuser else {})
        if problems:
            raise ValueError("; ".join(problems))
        return self

    def _window_problems(self) -> Iterator[str]:
        if self.window is None:
            return
        if any(self.bending.angles):
            shown = ", ".join(f"{math.degrees(angle):g}" for angle in self.bending.angles)
            yield f"window: bending.angles = {shown} deg, allowed with a window: 0 deg alone"
        if self.diffuser is not None:
            yield "window: there is a diffuser, allowed: one of the two, leave one out"
        if self.skin is not None:
            yield f"window: skin.shape = {self.skin.shape}, allowed with a window: a flat skin"
        if self.pad.index < MIN_BONDED_INDEX:
            yield (
                f"window: pad.index = {self.pad.index:g}, allowed with a window: at least "
                f"{MIN_BONDED_INDEX:g}"
            )
        depth, camera = self.window.thickness, self.camera
        placed = camera.position is not None and len(camera.position) == 3
        placed = placed or (camera.distance is not None and camera.y is not None)
        if placed and -depth <= camera.place[2] < 0.0:
            yield (
                f"window.thickness = {depth:g} mm reaches to the camera at z = "
                f"{camera.place[2]:g} mm, allowed: less than {-camera.place[2]:g} mm"
            )

    def _lamp_problems(self) -> Iterator[str]:
        pad, fibers, listed = self.pad, self.fibers, self.lamps or ()
        if fibers is None and self.schema_version == 1:
            yield "missing key fibers"
            return
        if fibers is not None and self.rows is not None:
            yield "rows: fibers are three rows already, allowed: one of the two"
            return
        if self.lamp_count == 0:
            named = "fibers: left, tip and right are all 0" if fibers else "there are no lamps"
            yield f"{named}, at least one {'fiber' if fibers else 'row or lamp'} is needed"
        if fibers is not None:
            yield from self._fiber_problems(fibers)
        alone = [
            *row_problems(self.rows or (), pad.width, pad.length),
            *listed_problems(listed),
        ]
        yield from alone
        if not alone:
            placed = [lamp for lamp in self.placed_lamps() if fibers is None or lamp.edge is None]
            yield from placement_problems(tuple(placed), self.box)
            yield from painted_lamp_problems(self.placed_lamps(), self.finishes, fibers is not None)
        edges: set[str] = {row.edge for row in self.lamp_rows if row.size}
        yield from self.baseline.problems(edges, len(listed), fibers is not None)

    def _fiber_problems(self, fibers: Fibers) -> Iterator[str]:
        if fibers.height > self.pad.thickness:
            yield (
                f"fibers.height = {fibers.height:g} mm lies above the pad, "
                f"allowed: 0 to pad.thickness = {self.pad.thickness:g} mm"
            )
        if fibers.diameter / 2 >= fibers.gap:
            yield (
                f"fibers.diameter = {fibers.diameter:g} mm cuts into the "
                f"{'diffuser' if self.diffuser else 'pad'} when the fiber turns, allowed: below "
                f"2 fibers.gap = {2 * fibers.gap:g} mm"
            )
        for row in fibers.rows():
            side = self.pad.width if row.edge == "tip" else self.pad.length
            needed = row.size * fibers.diameter
            if needed > side:
                yield (
                    f"fibers.{row.edge} = {row.size} fibers need {needed:g} mm, "
                    f"allowed: at most the edge of {side:g} mm"
                )

    def baseline_colors(self) -> tuple[str, ...]:
        """Return the color of each lamp in the design that others are compared with."""
        listed = iter(self.baseline.lamps or ())
        return tuple(
            getattr(self.baseline, lamp.edge) if lamp.edge else next(listed)
            for lamp in self.placed_lamps()
        )

    def with_sigma_v(self, factor: float) -> Scene:
        """Return the scene with every Gaussian profile ``factor`` times as wide."""

        def wider(part: Any) -> Any:
            if part.profile.sigma_v is None:
                return part
            width = {"sigma_v": part.profile.sigma_v * factor}
            return part.model_copy(update={"profile": part.profile.model_copy(update=width)})

        changed: dict[str, Any] = {
            name: tuple(wider(part) for part in getattr(self, name))
            for name in ("rows", "lamps")
            if getattr(self, name) is not None
        }
        if self.fibers is not None:
            width = {"sigma_v": self.fibers.sigma_v * factor}
            changed["fibers"] = self.fibers.model_copy(update=width)
        return self.model_copy(update=changed)

    @property
    def box(self) -> Box:
        """The outline of the flat silicone, and of the window under it."""
        thick = self.diffuser.thickness if self.diffuser else 0.0
        rims = tuple(thick if edge in self.diffuser_edges else 0.0 for edge in EDGES)
        depth = self.window.thickness if self.window else 0.0
        return Box(self.pad.width, self.pad.length, self.pad.thickness, rims, depth)

    @property
    def diffuser_edges(self) -> tuple[Edge, ...]:
        """The edges that a diffuser lies on."""
        return self.diffuser.edges if self.diffuser else ()

    @property
    def finishes(self) -> tuple[Finish, ...]:
        """What light meets on each of `FACES`."""
        return finishes(self.faces or (), self.pad.roughness)

    def finish(self, face: str) -> Finish:
        """Return what light meets on one of `FACES`."""
        return self.finishes[FACES.index(face)]

    @property
    def lamp_rows(self) -> tuple[Row, ...]:
        """Lamps along edges; the fibers of schema 1 are three rows."""
        return self.fibers.rows() if self.fibers is not None else self.rows or ()

    @property
    def lamp_count(self) -> int:
        """Number of lamps, in rows and listed."""
        return sum(row.size for row in self.lamp_rows) + len(self.lamps or ())

    @property
    def turning(self) -> tuple[bool, ...]:
        """Which lamps turn, in the order of their numbers."""
        rows = [row for edge in EDGES for row in self.lamp_rows if row.edge == edge]
        in_rows = [row.turns for row in rows for _ in range(row.size)]
        return (*in_rows, *(lamp.turns for lamp in self.lamps or ()))

    def placed_lamps(self) -> tuple[PlacedLamp, ...]:
        """Return all lamps on the flat pad, in the order of their numbers."""
        return placed_lamps(self.box, self.lamp_rows, self.lamps or ())

    @property
    def palette(self) -> Palette:
        """The LED colors, and what the camera's channels see of them."""
        return palette_of(self.colors, self.camera.channels)

    @property
    def hash(self) -> str:
        """16 hex digits that identify the physical content.

        Sources, the name, constraints, tolerances and free ranges change no light and have no part
        in it; nor has the schema: what both can say has one hash.
        """
        lightless = {"name", "constraints", "tolerances", "free"}
        content = self.model_dump(mode="json", exclude=lightless, exclude_none=True)
        content |= {"schema_version": 1, "diffuser": content.get("diffuser")}
        if self.diffuser is not None:
            content["diffuser"].pop("on", None)
            if self.diffuser_edges != RIM_EDGES:
                content["diffuser"]["on"] = self.diffuser_edges
        for color in content.get("colors", ()):
            color.pop("ink", None)
        # However the file groups them, and only those that are not like the rest of the pad.
        plain = Finish(self.pad.roughness)
        content["faces"] = {
            face: finish.content
            for face, finish in zip(FACES, self.finishes, strict=True)
            if finish != plain
        }
        if not content["faces"]:
            del content["faces"]
        if self.palette == RGB:
            content.pop("colors", None)
        if self.palette.channels == DEFAULT_CHANNELS:
            content["camera"].pop("channels", None)
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def load_scene(name_or_path: str | Path) -> Scene:
    """Return the validated scene of a shipped name (``finger20``) or a TOML file.

    Raises:
        SceneError: names every problem at once, each with key, value and allowed range.
    """
    return scene_from_text(scene_text(name_or_path), str(name_or_path), Path(name_or_path).parent)


def scene_from_text(text: str, origin: str, folder: Path) -> Scene:
    """Return the validated scene of a TOML text; ``origin`` is what errors call it.

    ``folder`` is where the files lie that it names.

    Raises:
        SceneError: as `load_scene` does.
    """
    raw = _parsed(text, origin)
    try:
        context = {"colors": colors_in(raw), "folder": folder}
        return Scene.model_validate(raw, context=context)
    except ValidationError as error:
        lines = [_sentence(problem) for problem in error.errors(include_url=False)]
        first = error.errors(include_url=False)[0]
        raise SceneError(
            f"{origin} is not a valid scene: " + "; ".join(lines),
            field=".".join(str(part) for part in first["loc"]),
        ) from None


def sources(name_or_path: str | Path) -> dict[str, str]:
    """Return the source of every value of a scene file, keyed like ``pad.width``."""
    raw = _parsed(scene_text(name_or_path), str(name_or_path))
    return dict(_sources(raw))


def _sources(content: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Yield the keys and sources of all values in a part of a scene file; colors have names."""
    if isinstance(content, dict) and "source" in content:
        yield key, str(content["source"])
        return
    parts: Any = content.items() if isinstance(content, dict) else ()
    if isinstance(content, list):
        parts = enumerate(content)
    for name, part in parts:
        if key == "colors":
            yield f"colors.{part['name']}", str(part["response"]["source"])
        else:
            yield from _sources(part, f"{key}.{name}" if key else str(name))


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
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise _unreadable(text_name, error) from None


def _parsed(text: str, origin: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _unreadable(origin, error) from None


def _unreadable(origin: str, error: Exception) -> SceneError:
    return SceneError(f"{origin} cannot be read as TOML: {error}", field="scene")


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
