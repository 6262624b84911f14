"""Lamps: rows along the pad's edges, and lamps that are listed one by one.

Lamps are numbered around the pad: left edge from base to tip, tip edge from left to right, right
edge from tip to base, base from right to left, and then those of the list. Rows of one edge come
one after the other. A lamp is the flat disk at the end of a fiber, or the face of an LED, in the
air or cast into the silicone; it hides nothing from the camera, nor from the light of others. Its
power and its profile are those of the light that leaves the disk, in whatever is there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import GetJsonSchemaHandler, model_validator
from pydantic_core import CoreSchema

from render.arrays import Array
from render.scene.lamp_profile import Profile, schema_with_half_angle, with_sigma_v
from render.scene.quantities import Count, Part, Quantity

Edge = Literal["left", "tip", "right", "base"]
RIM_EDGES: tuple[Edge, ...] = ("left", "tip", "right")
"""Where a diffuser lies, if there is one that names no edges."""
EDGES: tuple[Edge, ...] = (*RIM_EDGES, "base")
FACES = (*EDGES, "lower")
"""What light can enter the pad through: its edges and the face on the camera's side."""
OUTWARD = np.array(
    [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
)
"""Normals of `FACES`, into the air."""
AIR_FILM = 0.01
"""mm of air that is left between a lamp and a face that it touches: it is not glued on."""
VERTICAL = 1e-9
"""Horizontal part of a unit direction below which a lamp cannot turn about z."""

Diameter = Annotated[float, Quantity("mm", 0.05, 50.0)]
Solid = Literal["pad", "diffuser", "window"]
"""What a lamp can be cast into."""
Vector = Annotated[tuple[float, ...], Quantity("", -1000.0, 1000.0, many=True)]


class Fibers(Part):
    """Fiber ends, evenly spaced per edge; Gaussian radiance profile (thesis 3.3.1).

    ``height`` is the distance of the fiber axis from the camera-side face; ``gap`` the air between
    fiber end and diffuser; ``tilt`` the fixed angle towards the coating. The width of the beam is
    ``sigma_v``, or a file has `HalfAngle`.
    """

    left: Annotated[int, Count(0, 64)]
    tip: Annotated[int, Count(0, 64)]
    right: Annotated[int, Count(0, 64)]
    diameter: Annotated[float, Quantity("mm", 0.05, 5.0)]
    gap: Annotated[float, Quantity("mm", 0.05, 10.0)]
    height: Annotated[float, Quantity("mm", 0.0, 100.0)]
    sigma_v: Annotated[float, Quantity("deg", 0.1, 89.0)]
    tilt: Annotated[float, Quantity("deg", -60.0, 60.0)]

    @model_validator(mode="before")
    @classmethod
    def _width(cls, raw: Any) -> Any:
        return with_sigma_v(raw)

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the JSON schema, which takes a half angle in place of sigma_v."""
        found = handler(schema)
        schema_with_half_angle(handler.resolve_ref_schema(found))
        return found

    @property
    def count(self) -> int:
        """Number of fibers on all edges."""
        return self.left + self.tip + self.right

    def rows(self) -> tuple[Row, ...]:
        """Return the fibers as rows."""
        profile = Profile.model_construct(sigma_v=self.sigma_v)
        shared = {name: getattr(self, name) for name in ("diameter", "gap", "height", "tilt")}
        return tuple(
            Row.model_construct(edge=edge, count=getattr(self, edge), profile=profile, **shared)
            for edge in RIM_EDGES
        )


class Row(Part):
    """Lamps along one edge, evenly spaced, or ``at`` given places (mm from its middle).

    ``height`` is that of their centers above the camera-side face, ``gap`` the air before the pad
    or its diffuser, or below 0 how deep in them the lamps are cast in; ``tilt`` the fixed angle
    towards the coating. Lamps that do not ``turn`` shine straight in.
    """

    edge: Edge
    count: Annotated[int, Count(1, 64)] | None = None
    at: Annotated[tuple[float, ...], Quantity("mm", -1000.0, 1000.0, many=True)] | None = None
    diameter: Diameter
    gap: Annotated[float, Quantity("mm", -100.0, 100.0)]
    height: Annotated[float, Quantity("mm", -100.0, 100.0)]
    tilt: Annotated[float, Quantity("deg", -89.0, 89.0)] = 0.0
    profile: Profile
    turns: bool = True

    @property
    def size(self) -> int:
        """Number of lamps."""
        return len(self.at) if self.at is not None else self.count or 0


class ListedLamp(Part):
    """One lamp at ``position`` (mm, flat pad frame) that shines along ``direction`` (any length).

    One that ``turns`` does so about z, and shines along ``direction`` at 90 deg.
    """

    position: Annotated[tuple[float, ...], Quantity("mm", -1000.0, 1000.0, many=True)]
    direction: Vector
    diameter: Diameter
    profile: Profile
    turns: bool = False


def axes_across(direction: Array) -> Array:
    """Return two unit vectors ``(2, 3)`` normal to a unit ``direction`` and to each other."""
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


@dataclass(frozen=True, eq=False)
class PlacedLamp:
    """A lamp on the flat pad; vectors ``(3,)``, lengths in mm, angles in rad.

    Arguments:
        key: of the scene file, for messages.
        edge: of its row; None where it is listed.
        position: of the center of its end.
        along, inward: where it shines at phi = 0 and pi/2, without ``tilt`` towards the coating.
        face: index in `FACES` of the one that it shines through; of one in ``solid``, that next
            to it.
        diameter, profile, turns: of its end.
        solid: what it is cast into; None in the air.
    """

    key: str
    edge: Edge | None
    position: Array
    along: Array
    inward: Array
    tilt: float
    face: int
    diameter: float
    profile: Profile
    turns: bool
    solid: Solid | None = None

    @property
    def beam(self) -> Array:
        """Unit direction at phi = pi/2."""
        up = np.array([0.0, 0.0, 1.0])
        return np.asarray(math.cos(self.tilt) * self.inward + math.sin(self.tilt) * up)

    @property
    def recess(self) -> float:
        """How far (mm) its end reaches from its center towards the face, however it turns."""
        if self.turns:
            return self.diameter / 2
        across = 1.0 - float(self.beam @ OUTWARD[self.face]) ** 2
        return self.diameter / 2 * math.sqrt(max(across, 0.0))

    @property
    def half_size(self) -> Array:
        """How far ``(3,)`` its end reaches from its center along x, y and z, however it turns."""
        if self.turns:
            return np.full(3, self.diameter / 2)
        return np.asarray(self.diameter / 2 * np.sqrt(np.maximum(1.0 - self.beam**2, 0.0)))


@dataclass(frozen=True)
class Box:
    """The flat silicone: a clear pad with ``rims`` of diffuser, one thickness for each edge; mm.

    A window ``depth`` mm thick may lie under it.
    """

    width: float
    length: float
    thickness: float
    rims: tuple[float, ...]
    depth: float = 0.0

    @property
    def layered(self) -> NDArray[np.bool_]:
        """Which of `FACES` have a diffuser, ``(5,)``."""
        return np.array([*self.rims, 0.0]) > 0.0

    @property
    def low(self) -> Array:
        """Corner ``(3,)`` of least coordinates."""
        return np.array(
            [-self.width / 2 - self.rims[0], -self.length / 2 - self.rims[3], 0.0 - self.depth]
        )

    @property
    def high(self) -> Array:
        """Corner ``(3,)`` of greatest coordinates."""
        return np.array(
            [self.width / 2 + self.rims[2], self.length / 2 + self.rims[1], self.thickness]
        )

    def distance(self, position: Array) -> Array:
        """Return how far ``position`` lies outside of each of `FACES`, ``(5,)`` mm."""
        low, high = self.low - position, position - self.high
        return np.array([low[0], high[1], high[0], low[1], low[2]])

    def solid_at(self, position: Array) -> Solid | None:
        """Return what is at a position; None beside the silicone, and on its faces."""
        if (self.distance(position) >= 0.0).any() or position[2] >= self.thickness:
            return None
        if position[2] < 0.0:
            return "window"
        beside = np.abs(position[:2]) > [self.width / 2, self.length / 2]
        return "diffuser" if beside.any() else "pad"

    def room(self, position: Array, half_size: Array, *, refracts: bool) -> float:
        """Return how far (mm) the bounds of a lamp's end are from those of the solid around it.

        Below 0 they reach out of it. ``refracts`` is whether light bends between pad and window.
        """
        solid, pad = self.solid_at(position), np.array([self.width, self.length]) / 2
        low, high = self.low.copy(), self.high.copy()
        if solid == "pad":
            low[:2], high[:2] = -pad, pad
        if refracts:
            (high if solid == "window" else low)[2] = 0.0
        apart = np.minimum(position - half_size - low, high - position - half_size).min()
        if solid == "diffuser":
            apart = min(apart, float((np.abs(position[:2]) - half_size[:2] - pad).max()))
        return float(apart)

    def entered(self, position: Array, beam: Array) -> int:
        """Return the face that a beam enters through, else the one it is farthest outside of."""
        outside = self.distance(position)
        if self.solid_at(position) == "diffuser":
            outside = np.where(self.layered, outside, -np.inf)
        if not (outside > 0).any():
            return int(outside.argmax())
        speed = -OUTWARD @ beam
        way = np.where((outside > 0) & (speed > 1e-9), outside / np.maximum(speed, 1e-9), -1.0)
        last = int(way.argmax())
        axis = int(np.abs(OUTWARD[last]).argmax())
        place = position + way[last] * beam
        beside = np.delete((place < self.low - 1e-9) | (place > self.high + 1e-9), axis)
        return last if way[last] >= 0 and not beside.any() else int(outside.argmax())


def placed_lamps(
    box: Box, rows: tuple[Row, ...], listed: tuple[ListedLamp, ...], fibers: bool
) -> tuple[PlacedLamp, ...]:
    """Return all lamps in the order of their numbers; ``fibers``: the rows are the file's."""
    found: list[PlacedLamp] = []
    for edge in EDGES:
        for number, row in enumerate(rows):
            if row.edge == edge:
                key = f"fibers.{row.edge}" if fibers else f"rows.{number}"
                found += _row_lamps(box, row, key)
    return (*found, *(_listed(box, lamp, f"lamps.{i}") for i, lamp in enumerate(listed)))


def _row_lamps(box: Box, row: Row, key: str) -> Iterator[PlacedLamp]:
    number = EDGES.index(row.edge)
    outward = OUTWARD[number]
    # Which way lamps are numbered, and where phi = 0 points.
    way = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]])[number]
    along = np.array([0.0, 1.0, 0.0] if row.edge in ("left", "right") else [1.0, 0.0, 0.0])
    half = [box.width / 2, box.length / 2]
    length, depth = half if row.edge in ("tip", "base") else half[::-1]
    if row.at is not None:
        places = np.sort(np.array(row.at) * way.sum())
    else:
        places = (2 * (np.arange(row.size) + 0.5) / row.size - 1) * length
    turned = PlacedLamp(
        key=key,
        edge=row.edge,
        position=np.zeros(3),
        along=along,
        inward=-outward,
        tilt=row.tilt,
        face=number,
        diameter=row.diameter,
        profile=row.profile,
        turns=row.turns,
    )
    gap = row.gap
    if not row.turns and gap >= 0.0:
        gap = max(gap, turned.recess + AIR_FILM)
    offset = depth + (box.rims[number] + gap)
    for place in places:
        plane = place * way + offset * outward[:2]
        position = np.array([plane[0] + 0.0, plane[1] + 0.0, row.height])
        face = number
        if row.height < box.low[2] or gap < 0.0:
            face = box.entered(position, turned.beam)
        yield _moved(turned, position, face, box)


def _moved(lamp: PlacedLamp, position: Array, face: int, box: Box) -> PlacedLamp:
    changed = {"position": position, "face": face, "solid": box.solid_at(position)}
    return PlacedLamp(**{**vars(lamp), **changed})


def _listed(box: Box, lamp: ListedLamp, key: str) -> PlacedLamp:
    beam = np.array(lamp.direction[:3]) / max(np.linalg.norm(lamp.direction), 1e-30)
    flat = float(np.hypot(beam[0], beam[1]))
    inward = np.array([0.0, 1.0, 0.0]) if flat < VERTICAL else np.array([*beam[:2], 0.0]) / flat
    position = np.array(lamp.position)
    face = box.entered(position, beam)
    placed = PlacedLamp(
        key=key,
        edge=None,
        position=position,
        along=np.array([-inward[1], inward[0], 0.0]) + 0.0,
        inward=inward,
        tilt=math.atan2(beam[2], flat),
        face=face,
        diameter=lamp.diameter,
        profile=lamp.profile,
        turns=lamp.turns,
    )
    # One that touches a face keeps a film of air.
    missing = placed.recess + AIR_FILM - float(box.distance(position)[face])
    if not lamp.turns and 0 < missing <= AIR_FILM * (1 + 1e-6):
        position = position + missing * OUTWARD[face]
    return _moved(placed, position, face, box)
