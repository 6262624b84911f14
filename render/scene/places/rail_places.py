"""The places of a rail: one class for each kind, which gives bodies a position and a direction.

How to add a kind: name its key in `KINDS` with the keys that it needs and may have, write a
subclass of `RailPlaces` and name it in `PLACES_OF`. Candidates, keep-outs, mirror images and
refinement know no kind.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from render.arrays import Array
from render.scene.lamps import EDGES, OUTWARD, VERTICAL, Edge, PlacedLamp, Row, placed_lamps
from render.scene.places.polygon import border_distance, inside
from render.scene.places.search_section import Rail

if TYPE_CHECKING:
    from render.scene.schema.scene import Scene

PITCH = 2.0
"""Diameters between neighbors of a rail that names no pitch."""
ROUNDED = 4
"""Digits of mm that a candidate's place has."""
FINEST, FINEST_TILT = 0.1, math.radians(1.0)
"""mm and rad below which a place is not refined: no hand nor board is more exact."""
UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Place:
    """Where on a rail a lamp sits.

    Arguments:
        along: coordinates on it: mm along an edge, rad around a ring, x and y (mm) on a board, the
            number of an entry of a list.
        height: mm of the center over the lower face.
        tilt: rad towards the coating.
    """

    along: tuple[float, ...]
    height: float
    tilt: float


@dataclass(frozen=True, eq=False)
class CandidateLamp:
    """A lamp that may be placed.

    Arguments:
        rail, place: where it is; of an image, where that lamp is whose image it is.
        like: number of the lamp whose body it has.
        position, direction: ``(3,)`` mm, and a unit vector.
        edge: along which it sits, if there is one.
        image: whether it is the mirror image of a place.
    """

    rail: Rail
    place: Place
    like: int
    position: Array
    direction: Array
    edge: Edge | None = None
    image: bool = False

    @property
    def words(self) -> str:
        """Where it is, for people."""
        return f"{'the image of ' * self.image}a place on {self.rail.words}"

    @property
    def upright(self) -> bool:
        """Whether it shines along z, and so cannot turn about it."""
        return bool(np.hypot(*self.direction[:2]) < VERTICAL)


class RailPlaces(ABC):
    """The places of one rail of a scene.

    Arguments:
        kind: of the rail.
        like: number of the lamp whose body they have.
        pitch: mm between neighbors.
    """

    kind: ClassVar[str]

    def __init__(self, scene: Scene, rail: Rail) -> None:
        """Choose the lamp that those on the ``rail`` are like."""
        self.scene, self.rail = scene, rail
        lamps = scene.placed_lamps()
        self.like = _nearest(lamps, self.middle) if rail.like is None else rail.like
        self.body: PlacedLamp = lamps[self.like]
        self.pitch = PITCH * self.body.diameter if rail.pitch is None else rail.pitch

    @property
    @abstractmethod
    def middle(self) -> Array:
        """A place ``(3,)`` whose nearest lamp is the one that others are like."""

    @abstractmethod
    def grid(self) -> Iterator[tuple[float, ...]]:
        """Yield coordinates of places a pitch apart, in their order along the rail."""

    @property
    @abstractmethod
    def looked_at(self) -> int:
        """At most so many places are looked at, in all heights."""

    @abstractmethod
    def holds(self, along: tuple[float, ...]) -> bool:
        """Return whether the rail reaches to some coordinates."""

    @abstractmethod
    def pose(self, place: Place) -> tuple[Array, Array]:
        """Return position ``(3,)`` mm and direction ``(3,)`` of a lamp on a place."""

    @property
    def steps(self) -> tuple[float, ...]:
        """What of each coordinate is a pitch, in its own unit; 0 where it cannot be moved."""
        return (self.pitch,)

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """Ends between which ``height`` (mm) and ``tilt`` (rad) are free."""
        ranges = {"height": self.rail.height_range, "tilt": self.rail.tilt_range}
        return {name: (ends[0], ends[1]) for name, ends in ranges.items() if ends is not None}

    def around(self, place: Place, part: float) -> Iterator[Place]:
        """Yield the places next to one, by a ``part`` of a pitch or of what is free."""
        for number, step in enumerate(self.steps):
            for way in (-part * step, part * step) if step else ():
                moved = list(place.along)
                moved[number] += way
                if self.holds(tuple(moved)):
                    yield replace(place, along=tuple(moved))
        for name, (low, high) in self.spans.items():
            here = getattr(place, name)
            for way in (-part * (high - low), part * (high - low)):
                value = min(max(here + way, low), high)
                if value != here:
                    yield replace(place, **{name: value})

    @property
    def widest(self) -> float:
        """The widest that is free, in units of how fine it is to be known; 0: nothing is."""
        free = [self.pitch / FINEST if any(self.steps) else 0.0]
        for name, (low, high) in self.spans.items():
            free.append((high - low) / (FINEST if name == "height" else FINEST_TILT))
        return max(free)

    @property
    def heights(self) -> tuple[float, ...]:
        """Heights (mm) that places are looked at in."""
        return self.rail.heights or (float(self.body.position[2]),)

    @property
    def tilt(self) -> float:
        """Tilt (rad) that places are looked at with."""
        usual = self.body.tilt if self.rail.tilt is None else self.rail.tilt
        low, high = self.rail.tilt_range or (usual, usual)
        return min(max(usual, low), high)

    def candidates(self) -> Iterator[CandidateLamp]:
        """Yield the places of the grid, whatever lies there already."""
        for height in self.heights:
            for along in self.grid():
                yield self.candidate(Place(along, height, self.tilt))

    def candidate(self, place: Place) -> CandidateLamp:
        """Return the lamp on a place."""
        position, direction = self.pose(place)
        return CandidateLamp(
            self.rail,
            place,
            self.like,
            np.round(position, ROUNDED) + 0.0,
            direction + 0.0,
            self.rail.edge,
        )


class EdgePlaces(RailPlaces):
    """Places along an edge, as a row of the file has them."""

    kind = "edge"

    @property
    def middle(self) -> Array:
        """The edge's middle."""
        box, outward = self.scene.box, self._outward
        face = outward * np.abs([*box.low[:2], 0.0] if outward.sum() < 0 else box.high)
        return np.asarray(face * [1.0, 1.0, 0.0])

    @property
    def heights(self) -> tuple[float, ...]:
        """Those of the rail, or of all lamps on the edge of the one that places are like."""
        lamps, own = self.scene.placed_lamps(), _edge_of(self.body)
        if self.rail.heights is not None:
            return self.rail.heights
        found = {round(float(one.position[2]), ROUNDED) for one in lamps if _edge_of(one) == own}
        low, high = self.rail.height_range or (-math.inf, math.inf)
        return tuple(sorted({min(max(height, low), high) for height in found}))

    @property
    def steps(self) -> tuple[float, ...]:
        """A pitch, unless places are named one by one."""
        return (0.0 if self.rail.at is not None else self.pitch,)

    @property
    def looked_at(self) -> int:
        """As many as the rail has."""
        low, high = self._ends
        along = len(self.rail.at) if self.rail.at is not None else (high - low) / self.pitch + 1
        return int(along) * len(self.heights)

    def grid(self) -> Iterator[tuple[float, ...]]:
        """Yield mm from the edge's middle."""
        if self.rail.at is not None:
            yield from ((place,) for place in sorted(self.rail.at))
            return
        low, high = self._ends
        steps = math.floor((high - low) / self.pitch + 1e-9)
        for step in range(steps + 1):
            yield ((low + high + (2 * step - steps) * self.pitch) / 2,)

    def holds(self, along: tuple[float, ...]) -> bool:
        """Return whether a place lies between the rail's ends."""
        low, high = self._ends
        return low - 1e-9 <= along[0] <= high + 1e-9

    def pose(self, place: Place) -> tuple[Array, Array]:
        """Return where a row of the edge has its lamp."""
        body, gap = self.body, self.rail.gap
        assert self.rail.edge is not None
        if gap is None:
            gap = float(self.scene.box.distance(body.position)[_edge_of(body)])
        row = Row.model_construct(
            edge=self.rail.edge,
            at=place.along,
            diameter=body.diameter,
            gap=gap,
            height=place.height,
            tilt=place.tilt,
            profile=body.profile,
            turns=body.turns,
        )
        (lamp,) = placed_lamps(self.scene.box, (row,), (), False)
        return lamp.position, lamp.beam

    @property
    def _outward(self) -> Array:
        assert self.rail.edge is not None
        return np.asarray(OUTWARD[EDGES.index(self.rail.edge)])

    @property
    def _ends(self) -> tuple[float, float]:
        assert self.rail.edge is not None
        half, radius = half_edge(self.scene, self.rail.edge), self.body.diameter / 2
        low, high = self.rail.between or (radius - half, half - radius)
        return low, high


class RingPlaces(RailPlaces):
    """Places on a circle about z, from angle to angle."""

    kind = "ring"

    @property
    def middle(self) -> Array:
        """The ring's center."""
        return np.array([*(self.rail.center or (0.0, 0.0)), 0.0])

    @property
    def steps(self) -> tuple[float, ...]:
        """A pitch as an angle."""
        return (self.pitch / self._radius,)

    @property
    def looked_at(self) -> int:
        """As many as the rail has."""
        low, high = self.rail.angles or (0.0, 2 * math.pi)
        return int((high - low) / self.steps[0] + 1) * len(self.heights)

    def grid(self) -> Iterator[tuple[float, ...]]:
        """Yield angles, evenly spaced, at least a pitch apart along the ring."""
        low, high = self.rail.angles or (0.0, 2 * math.pi)
        whole = high - low > 2 * math.pi - 1e-9
        count = math.floor((high - low) / self.steps[0] + 1e-9)
        if whole:
            yield from ((low + turn * 2 * math.pi / count,) for turn in range(count))
            return
        start = (low + high - count * self.steps[0]) / 2
        yield from ((start + step * self.steps[0],) for step in range(count + 1))

    def holds(self, along: tuple[float, ...]) -> bool:
        """Return whether an angle lies between the ends; all do of a whole ring."""
        low, high = self.rail.angles or (-math.inf, math.inf)
        whole = high - low > 2 * math.pi - 1e-9
        return whole or low - 1e-9 <= along[0] <= high + 1e-9

    def pose(self, place: Place) -> tuple[Array, Array]:
        """Return a place on the circle, from which a lamp shines to the middle."""
        (angle,) = place.along
        outward = np.array([math.cos(angle), math.sin(angle), 0.0])
        position = self.middle + self._radius * outward + [0.0, 0.0, place.height]
        tilted = -math.cos(place.tilt) * outward + math.sin(place.tilt) * np.array(UP)
        return position, tilted if self.rail.direction is None else _unit(self.rail.direction)

    @property
    def _radius(self) -> float:
        assert self.rail.radius is not None
        return self.rail.radius


class BoardPlaces(RailPlaces):
    """A square grid inside a polygon, its middle that of the polygon's bounds."""

    kind = "board"

    @property
    def middle(self) -> Array:
        """The middle of the board's bounds."""
        corners = self._corners
        return np.array([*(corners.min(axis=0) + corners.max(axis=0)) / 2, 0.0])

    @property
    def steps(self) -> tuple[float, ...]:
        """A pitch along x and y."""
        return (self.pitch, self.pitch)

    @property
    def looked_at(self) -> int:
        """As many as the polygon's bounds have."""
        along = np.ptp(self._corners, axis=0) / self.pitch + 1
        return int(along[0]) * int(along[1]) * len(self.heights)

    def grid(self) -> Iterator[tuple[float, ...]]:
        """Yield x and y, row by row."""
        size = np.ptp(self._corners, axis=0) - self.body.diameter
        if (size < -1e-9).any():
            return
        columns, rows = np.floor(size / self.pitch + 1e-9).astype(int).tolist()
        for row in range(rows + 1):
            for column in range(columns + 1):
                x = self.middle[0] + (column - columns / 2) * self.pitch
                y = self.middle[1] + (row - rows / 2) * self.pitch
                if self.holds((x, y)):
                    yield x, y

    def holds(self, along: tuple[float, ...]) -> bool:
        """Return whether a body lies on the board wholly."""
        place, radius = np.array(along), self.body.diameter / 2
        return bool(
            inside(place, self._corners) and border_distance(place, self._corners) >= radius - 1e-9
        )

    def pose(self, place: Place) -> tuple[Array, Array]:
        """Return a place on the board, from which a lamp shines up."""
        return np.array([*place.along, place.height]), _unit(self.rail.direction or UP)

    @property
    def _corners(self) -> Array:
        return np.array(self.rail.corners)


class ListPlaces(RailPlaces):
    """Places that are named one by one, each with a direction."""

    kind = "list"

    @property
    def middle(self) -> Array:
        """The mean of all places."""
        return np.asarray(np.mean(self.rail.positions or (UP,), axis=0))

    @property
    def heights(self) -> tuple[float, ...]:
        """None beside those of the places themselves."""
        return (0.0,)

    @property
    def steps(self) -> tuple[float, ...]:
        """Nothing moves."""
        return (0.0,)

    @property
    def looked_at(self) -> int:
        """As many as the list has."""
        return len(self.rail.positions or ())

    def grid(self) -> Iterator[tuple[float, ...]]:
        """Yield numbers of entries."""
        yield from ((float(number),) for number in range(len(self.rail.positions or ())))

    def holds(self, along: tuple[float, ...]) -> bool:
        """Return whether there is such an entry."""
        return along[0] in range(len(self.rail.positions or ()))

    def pose(self, place: Place) -> tuple[Array, Array]:
        """Return an entry of the list."""
        number = int(place.along[0])
        assert self.rail.positions is not None
        assert self.rail.directions is not None
        return np.array(self.rail.positions[number]), _unit(self.rail.directions[number])


PLACES_OF: dict[str, type[RailPlaces]] = {
    one.kind: one for one in (EdgePlaces, RingPlaces, BoardPlaces, ListPlaces)
}


def rail_places(scene: Scene, rail: Rail) -> RailPlaces:
    """Return the places of a rail."""
    return PLACES_OF[rail.kind](scene, rail)


def half_edge(scene: Scene, edge: Edge) -> float:
    """Return half the length of an edge, mm."""
    return (scene.pad.width if edge in ("tip", "base") else scene.pad.length) / 2


def _unit(direction: tuple[float, ...]) -> Array:
    return np.asarray(np.array(direction) / np.linalg.norm(direction))


def _edge_of(lamp: PlacedLamp) -> int:
    """Return the number of the edge that a lamp belongs to: that of its row, or behind it."""
    if lamp.edge is not None:
        return EDGES.index(lamp.edge)
    if lamp.face < len(EDGES):
        return lamp.face
    return int((-OUTWARD[: len(EDGES)] @ lamp.inward).argmax())


def _nearest(lamps: tuple[PlacedLamp, ...], place: Array) -> int:
    """Return the number of the lamp nearest to a ``place``, seen along z."""
    return int(np.argmin([np.hypot(*(lamp.position - place)[:2]) for lamp in lamps]))
