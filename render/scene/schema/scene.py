"""The scene file: what a sensor is made of, read from TOML and validated strictly.

Files hold lengths in mm, angles in degrees and coefficients in 1/mm, each with its unit and the
source of the value. In memory lengths are mm, angles radians and coefficients 1/mm, all float64.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from render.arguments import as_kind
from render.errors import SceneError
from render.scene.camera import Camera
from render.scene.catalog import Led
from render.scene.colors import LedColor, Palette, palette_of
from render.scene.constraints import Constraints
from render.scene.faces import Finish, NamedFaces, finishes
from render.scene.free_ranges import FreeRanges
from render.scene.lamps import (
    EDGES,
    FACES,
    Box,
    Edge,
    Fibers,
    ListedLamp,
    PlacedLamp,
    Row,
    placed_lamps,
)
from render.scene.places.search_section import Search
from render.scene.quantities import Part, since_schema_2, unchecked
from render.scene.schema.content_hash import content_hash
from render.scene.schema.fitting import fitting_problems
from render.scene.sections import Baseline, Bending, Coating, Diffuser, Indenter, Pad, Sites, Window
from render.scene.skin import Skin
from render.scene.states import REST, State
from render.scene.tolerances import Tolerances

SCENE_NAME = r"^[a-z0-9][a-z0-9_-]{0,63}$"


@dataclass(frozen=True, eq=False)
class Written:
    """The file a scene was read from: its content, the folder of files that it names, its text.

    ``origin`` is its path or a shipped name; ``text`` is None where the content was changed.
    How a scene is written has no part in which one it is: all are equal, and equal to None.
    """

    content: dict[str, Any]
    folder: Path
    origin: str
    text: str | None = None

    def __eq__(self, other: object) -> bool:
        """Return that it makes no difference."""
        return True

    __hash__ = None  # type: ignore[assignment]


class Scene(Part):
    """One sensor, completely: what every level of the fidelity ladder is built from."""

    schema_version: Annotated[Literal[1, 2], Field(alias="schema")]
    name: Annotated[str, Field(pattern=SCENE_NAME)]
    pad: Pad
    diffuser: Diffuser | None = None
    window: Window | None = since_schema_2()
    coating: Coating
    skin: Skin | None = since_schema_2()
    states: tuple[State, ...] | None = since_schema_2()
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
    search: Search | None = since_schema_2()
    parts: Annotated[tuple[Led, ...], Field(strict=False, min_length=1)] | None = since_schema_2()
    tolerances: Tolerances | None = None
    free: FreeRanges | None = None
    _written: Written | None = None

    def __init__(self, *_given: object, **content: object) -> None:
        """Say how scenes are made: what a file holds is read by `load_scene` alone."""
        keys = ", ".join(content)
        raise SceneError(
            f"Scene({keys}) makes none, allowed: load_scene(name_or_path), and with_ of a scene",
            field=keys,
        )

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # files are read past it

    def with_(self, **changes: Any) -> Scene:
        """Return the scene that its file describes after an edit, validated as a file is.

        Keys are paths of the scene file, values have the file's units (mm, deg, 1/mm)::

            scene.with_(pad_thickness=3.0, bending_angles=[0, 30])
            scene.with_(**{"pad.thickness": 3.0, "rows.0.gap": 0.5}, diffuser={"g": 0.8})

        In a key without dots underscores may stand for them. A value is a plain one, or what the
        file has (``{"value": 3.0, "unit": "mm", "source": "drawing"}``). A table changes the keys
        that it names, a list takes the place of the whole list, None leaves a key out.

        Raises:
            SceneError: what the file would be refused for, an ambiguous key, or this scene was made
                in memory from another one.
        """
        from render.scene.scene_file import changed_scene

        return changed_scene(self, changes)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Scene:
        """Return a copy whose values in ``update`` are checked, and fit to the rest.

        They are in memory units (mm, rad); `with_` takes those of the file.

        Raises:
            SceneError: an unknown key, a value that no file may have, or parts that do not fit.
        """
        copy = super().model_copy(update=update, deep=deep)
        # Which keys a file may have is its schema's, and states may lack what a file must have.
        newest = {"schema_version": 2}
        problems = fitting_problems(unchecked(copy, newest)) if update else []
        if problems:
            before = fitting_problems(unchecked(self, newest))
            problems = [problem for problem in problems if problem not in before]
        if problems:
            raise SceneError(f"the copy of {self.name} is no valid scene: {'; '.join(problems)}")
        return copy

    def __repr__(self) -> str:
        """Return the scene in one line."""
        pad, count = self.pad, len(self.state_axis)
        word = self.state_word or "state"
        return (
            f"<Scene {self.name} ({self.hash}): pad {pad.width:g} x {pad.length:g} x "
            f"{pad.thickness:g} mm, {self.lamp_count} lamp{'s' * (self.lamp_count != 1)}, "
            f"{self.sites.count} site{'s' * (self.sites.count != 1)} of {self.indenter.faces} "
            f"facets, {count} {word}{'s' * (count != 1)}>"
        )

    __str__ = __repr__

    def _repr_html_(self) -> str:
        """Return the line and a drawing of the sensor."""
        from render.notebook import captioned
        from render.sensor_drawing import sensor_svg

        return captioned(repr(self), sensor_svg(self))

    @model_validator(mode="before")
    @classmethod
    def _lists_become_tuples(cls, raw: Any) -> Any:
        """TOML has lists where parts are tuples."""
        if not isinstance(raw, dict):
            return raw
        raw = dict(raw)
        for key in ("faces", "rows", "lamps", "states"):
            if isinstance(raw.get(key), list):
                raw[key] = tuple(raw[key])
        return raw

    @model_validator(mode="after")
    def _parts_fit_together(self) -> Scene:
        problems = fitting_problems(self)
        if problems:
            raise ValueError("; ".join(problems))
        # What is the same in all channels has one number, however the file says it.
        return self if self.by_channel else self.with_albedo(self.albedos[0])

    @property
    def state_axis(self) -> tuple[float, ...]:
        """What the axis of states has: bends in rad, or the numbers of `state_names` from 0."""
        if self.states is None:
            return self.bending.angles
        return tuple(float(number) for number in range(1 + len(self.states)))

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states on their axis, for people."""
        if self.states is None:
            return tuple(f"bend {math.degrees(angle):g}°" for angle in self.bending.angles)
        return (REST, *(state.name for state in self.states))

    @property
    def state_word(self) -> str:
        """What the axis of states has: "bend", "state", or "" for a skin of one shape."""
        if len(self.state_axis) == 1:
            return ""
        return "bend" if self.states is None else "state"

    @property
    def state_titles(self) -> tuple[str, ...]:
        """What pictures of the states are called: `state_names`, "" for a skin of one shape."""
        return self.state_names if self.state_word else ("",)

    def in_state(self, number: float) -> Scene:
        """Return the sensor whose skin stays in one state, by its number on `state_axis`.

        Which sites count is up to that state alone; `render.geometry.in_state` knows of the others.

        Raises:
            SceneError: there is no such state.
        """
        as_kind(number, Real, "number", "the number of a state", SceneError)
        if self.states is None or number not in self.state_axis:
            raise SceneError(
                f"state {number:g} of {self.name}, allowed: a number of its states "
                f"({', '.join(self.state_names)}), from 0",
                field="states",
            )
        name = self.state_names[int(number)]
        changed: dict[str, Any] = {"name": f"{self.name}-{name}", "states": None}
        if number > 0 and self.skin is not None:
            state = self.states[int(number) - 1]
            crown, carried = state.crown_of(self.skin, self.pad), state.carried(self.sites)
            changed["skin"] = state.skin_of(self.skin)
            changed["pad"] = unchecked(self.pad, {"thickness": crown})
            if carried is not None:
                changed["sites"] = unchecked(self.sites, {"carried": carried})
        return unchecked(self, changed)

    def baseline_colors(self) -> tuple[str, ...]:
        """Return the color of each lamp in the design that others are compared with."""
        named: dict[str | None, Iterator[str]] = {None: iter(self.baseline.lamps or ())}
        for edge in EDGES:
            colors = getattr(self.baseline, edge)
            named[edge] = (
                itertools.repeat(colors) if isinstance(colors, str) else iter(colors or ())
            )
        return tuple(next(named[lamp.edge]) for lamp in self.placed_lamps())

    def with_sigma_v(self, factor: float) -> Scene:
        """Return the scene with every Gaussian profile ``factor`` times as wide."""

        def wider(part: Any) -> Any:
            if part.profile.sigma_v is None:
                return part
            width = {"sigma_v": part.profile.sigma_v * factor}
            return unchecked(part, {"profile": unchecked(part.profile, width)})

        changed: dict[str, Any] = {
            name: tuple(wider(part) for part in getattr(self, name))
            for name in ("rows", "lamps")
            if getattr(self, name) is not None
        }
        if self.fibers is not None:
            width = {"sigma_v": self.fibers.sigma_v * factor}
            changed["fibers"] = unchecked(self.fibers, width)
        return unchecked(self, changed)

    @property
    def box(self) -> Box:
        """The outline of the flat silicone, and of the window under it."""
        thick = self.diffuser.thickness if self.diffuser else 0.0
        rims = tuple(thick if edge in self.diffuser_edges else 0.0 for edge in EDGES)
        depth = self.window.thickness if self.window else 0.0
        return Box(self.pad.width, self.pad.length, self.pad.thickness, rims, depth)

    @property
    def window_refracts(self) -> bool:
        """Whether light bends where the pad meets its window."""
        return self.window is not None and self.window.index != self.pad.index

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
        return placed_lamps(self.box, self.lamp_rows, self.lamps or (), self.fibers is not None)

    @property
    def palette(self) -> Palette:
        """The LED colors, and what the camera's channels see of them."""
        return palette_of(self.colors, self.camera.channels, self.camera.shots or 1)

    @property
    def albedos(self) -> tuple[float, ...]:
        """The different albedos of the skin, in the order of the channels that have them."""
        albedo = self.coating.albedo
        return (albedo,) if isinstance(albedo, float) else tuple(dict.fromkeys(albedo))

    @property
    def albedo_of_channel(self) -> tuple[int, ...]:
        """Which of `albedos` each channel of the camera sees, ``(channel,)``."""
        albedo = self.coating.albedo
        if isinstance(albedo, float):
            return (0,) * len(self.palette.channels)
        return tuple(self.albedos.index(value) for value in albedo) * self.palette.shots

    @property
    def one_albedo_scenes(self) -> tuple[Scene, ...]:
        """The scene with each of `albedos` in all channels: what light of a channel meets."""
        return tuple(self.with_albedo(albedo) for albedo in self.albedos)

    @property
    def by_channel(self) -> bool:
        """Whether materials depend on the camera's channel, and transport has an axis for it."""
        return len(self.albedos) > 1

    def with_albedo(self, albedo: float) -> Scene:
        """Return the scene whose skin has one ``albedo`` in all channels."""
        if albedo == self.coating.albedo:
            return self
        return unchecked(self, {"coating": unchecked(self.coating, {"albedo": albedo})})

    @property
    def hash(self) -> str:
        """16 hex digits that identify the physical content.

        Sources, the name, constraints, what a search decides, tolerances, free ranges and what a
        camera makes of its light change no light and have no part in it; nor has the schema: what
        both can say has one hash.
        """
        return content_hash(self)
