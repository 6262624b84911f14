"""The scene file: what a sensor is made of, read from TOML and validated strictly.

Files hold lengths in mm, angles in degrees and coefficients in 1/mm, each with its unit and the
source of the value. In memory lengths are mm, angles radians and coefficients 1/mm, all float64.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, model_validator

from render.errors import SceneError
from render.scene.built_geometry import (
    deep_row_problems,
    embedding_problems,
    embedding_under_skin_problems,
    listed_problems,
    placement_problems,
    row_problems,
    skin_problems,
)
from render.scene.camera import Camera
from render.scene.colors import (
    DEFAULT_CHANNELS,
    OFF,
    RGB,
    LedColor,
    Palette,
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
    placed_lamps,
)
from render.scene.parts import (
    MIN_BONDED_INDEX,
    Baseline,
    Bending,
    Coating,
    Diffuser,
    Indenter,
    Pad,
    Sites,
    Window,
)
from render.scene.quantities import Part, keys_of_schema_2, since_schema_2
from render.scene.skin import Skin
from render.scene.states import REST, State, site_problems, state_problems
from render.scene.tolerances import Tolerances

SCENE_NAME = r"^[a-z0-9][a-z0-9_-]{0,63}$"


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
        for key in ("faces", "rows", "lamps", "states"):
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
            if not isinstance(self.coating.albedo, float):
                problems.append("coating.albedo with a list of values needs schema = 2")
        problems += self.camera.problems()
        problems += self.coating.problems(self.palette.channels)
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
        if self.states is not None:
            problems += state_problems(self.states, self.skin, self.pad, angles)
        if not problems and self.skin is not None:
            problems += self._skin_problems()
        elif not problems:
            problems += self._embedding_problems()
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
        problems += self._moving_layer_problems(problems)
        if self.free is not None:
            problems += self.free.problems(self.diffuser.free_values if self.diffuser else {})
        if problems:
            raise ValueError("; ".join(problems))
        # What is the same in all channels has one number, however the file says it.
        return self if self.by_channel else self.with_albedo(self.albedos[0])

    def _moving_layer_problems(self, others: list[str]) -> Iterator[str]:
        """Yield what would move the border of a diffuser to lamps that are cast in beside it."""
        if others or self.diffuser is None:
            return
        cast = [number for number, lamp in enumerate(self.placed_lamps()) if lamp.solid]
        for name, part in (("tolerances", self.tolerances), ("free", self.free)):
            if cast and part is not None and part.diffuser_thickness is not None:
                yield (
                    f"{name}.diffuser_thickness: lamp {cast[0]} is cast into the silicone, and "
                    "does not move with the diffuser, allowed: lamps in the air, or leave it out"
                )

    def _skin_problems(self) -> Iterator[str]:
        """Yield what is wrong with the skin, and in each of its states."""
        for number, name in zip(self.state_axis, self.state_names, strict=True):
            one = self if self.states is None else self.in_state(number)
            assert one.skin is not None
            alone = list(
                skin_problems(
                    one.skin,
                    one.pad,
                    one.bending,
                    one.diffuser,
                    one.placed_lamps(),
                    one.sites,
                    one.indenter,
                )
            )
            if not alone and name != REST:
                alone += placement_problems(one.placed_lamps(), one.box)
            if not alone:
                alone += one._embedding_problems()
            if name == REST or self.states is None:
                yield from alone
                if alone:  # states follow a skin that is right
                    return
                continue
            yield from (f"states: in {name} {problem}" for problem in alone)
            if one.sites.carried is not None:
                yield from site_problems(one.sites, one.pad, one.indenter.clearance, name)

    def _embedding_problems(self) -> Iterator[str]:
        """Yield which lamps in the silicone reach through the skin, or into a pyramid."""
        lamps = self.placed_lamps()
        if any(lamp.solid for lamp in lamps):
            yield from embedding_under_skin_problems(
                lamps, self.pad, self.skin, self.sites, self.indenter
            )

    def _window_problems(self) -> Iterator[str]:
        if self.window is None:
            return
        if not self.bending.rigid:
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
            refracts = self.window_refracts
            yield from embedding_problems(tuple(placed), self.box, refracts=refracts)
            yield from deep_row_problems(self.rows or (), tuple(placed))
            yield from painted_lamp_problems(self.placed_lamps(), self.finishes)
        lit = Counter[str]()
        for row in self.lamp_rows:
            lit[row.edge] += row.size
        yield from self.baseline.problems(+lit, len(listed), fibers is not None)

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

    def in_state(self, number: float) -> Scene:
        """Return the sensor whose skin stays in one state, by its number on `state_axis`.

        Which sites count is up to that state alone; `render.geometry.in_state` knows of the others.

        Raises:
            SceneError: there is no such state.
        """
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
            changed["pad"] = self.pad.model_copy(update={"thickness": crown})
            if carried is not None:
                changed["sites"] = self.sites.model_copy(update={"carried": carried})
        return self.model_copy(update=changed)

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
        return palette_of(self.colors, self.camera.channels)

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
        return tuple(self.albedos.index(value) for value in albedo)

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
        return self.model_copy(
            update={"coating": self.coating.model_copy(update={"albedo": albedo})}
        )

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
        if self.coating.lobe is None:
            for key in ("specular", "roughness"):
                content["coating"].pop(key, None)
        for color in content.get("colors", ()):
            color.pop("ink", None)
        for state in content.get("states", ()):
            state.pop("name")
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
