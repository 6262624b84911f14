"""What a search may decide beyond colors and directions: an optional section of the scene file.

Where lamps may sit, and how many may be lit. It says which designs may be chosen, not what light
does, so it has no part in the scene's hash.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from render.arrays import Array
from render.refused_values import did_you_mean
from render.scene.colors import ColorName
from render.scene.constraints import Constraints
from render.scene.lamps import Edge, Vector
from render.scene.places.polygon import border_distance, inside, polygon_problems
from render.scene.quantities import Count, Part, PointList, Quantity

Places = Annotated[tuple[float, ...], Quantity("mm", -1000.0, 1000.0, many=True)]
Heights = Annotated[tuple[float, ...], Quantity("mm", -100.0, 100.0, many=True)]
Corners = Annotated[tuple[tuple[float, ...], ...], PointList("mm", -1000.0, 1000.0)]
Distance = Annotated[float, Quantity("mm", 0.05, 100.0)]
KINDS = {"edge": "edge", "radius": "ring", "corners": "board", "positions": "list"}
"""The key that says what a rail is, and how it is called."""
NEEDED = {
    "edge": frozenset({"edge"}),
    "ring": frozenset({"radius", "heights"}),
    "board": frozenset({"corners", "heights"}),
    "list": frozenset({"positions", "directions"}),
}
OPTIONAL = {
    "edge": frozenset({"between", "at", "pitch", "heights", "gap", "tilt"})
    | {"height_range", "tilt_range"},
    "ring": frozenset({"center", "angles", "pitch", "tilt", "direction"})
    | {"height_range", "tilt_range"},
    "board": frozenset({"pitch", "direction", "height_range"}),
    "list": frozenset[str](),
}
"""Keys of each kind, beside ``like``, which all have."""


class Rail(Part):
    """Places on which lamps may sit: along an edge or a ring, on a board, or in a list.

    Along one ``edge`` they lie ``between`` two places (mm from the edge's middle, towards the tip
    or the right), a ``pitch`` apart; or ``at`` given ones. Without these they fill the whole edge,
    two diameters apart. ``gap`` and ``tilt`` are as rows have them.

    A ring has a ``center`` (x and y) and a ``radius``; places go from one of two ``angles`` to the
    other (deg from x towards y), or all around, and lamps shine to its middle.
    A board is a polygon of ``corners`` (x and y) that holds bodies wholly; lamps shine up.
    Lamps of both shine along a ``direction`` where one is given.
    A list has ``positions`` and as many ``directions``.

    Lamps are like one of the scene's: ``like`` is its number, or else it is the nearest. Values
    that an edge leaves out are those of that lamp, and ``heights`` (mm, of centers over the lower
    face) those of all on its edge. Within ``height_range`` and ``tilt_range`` both are free.
    """

    edge: Edge | None = None
    between: Places | None = None
    at: Places | None = None
    center: Places | None = None
    radius: Distance | None = None
    angles: Annotated[tuple[float, ...], Quantity("deg", -360.0, 360.0, many=True)] | None = None
    corners: Corners | None = None
    positions: Annotated[
        tuple[tuple[float, ...], ...], PointList("mm", -1000.0, 1000.0, size=3)
    ] | None = None  # fmt: skip
    directions: Annotated[
        tuple[tuple[float, ...], ...], PointList("", -1000.0, 1000.0, size=3)
    ] | None = None  # fmt: skip
    pitch: Distance | None = None
    heights: Heights | None = None
    height_range: Heights | None = None
    gap: Annotated[float, Quantity("mm", -100.0, 100.0)] | None = None
    tilt: Annotated[float, Quantity("deg", -89.0, 89.0)] | None = None
    tilt_range: Annotated[
        tuple[float, ...], Quantity("deg", -89.0, 89.0, many=True)
    ] | None = None  # fmt: skip
    direction: Vector | None = None
    like: Annotated[int, Count(0, 1023)] | None = None

    @property
    def kind(self) -> str:
        """What it is: ``edge``, ``ring``, ``board`` or ``list``."""
        return next(kind for key, kind in KINDS.items() if getattr(self, key) is not None)

    @property
    def words(self) -> str:
        """Where its places are, for people."""
        kind = self.kind
        if kind == "ring":
            x, y = self.center or (0.0, 0.0)
            return f"a ring of {self.radius:g} mm about ({x:g}, {y:g}) mm"
        return {"edge": f"the {self.edge} edge", "board": "a board", "list": "a list"}[kind]

    def problems(self, key: str, lamps: int) -> Iterator[str]:
        """Yield what is wrong with the rail by itself; the scene has so many ``lamps``."""
        named = {name for name in type(self).model_fields if getattr(self, name) is not None}
        kinds = [name for name in KINDS if name in named]
        if len(kinds) != 1:
            said = f"names {' and '.join(kinds)}" if kinds else "says not where lamps may sit"
            yield f"{key} {said}, allowed: one of {', '.join(KINDS)}"
            return
        kind = self.kind
        for name in sorted(NEEDED[kind] - named):
            yield f"missing key {key}.{name}"
        for name in sorted(named - NEEDED[kind] - OPTIONAL[kind] - {"like"}):
            allowed = ", ".join(sorted(NEEDED[kind] | OPTIONAL[kind]))
            yield f"{key}.{name}: {'an' if kind == 'edge' else 'a'} {kind} has none, " \
                  f"allowed: {allowed}"  # fmt: skip
        if self.at is not None and (self.between is not None or self.pitch is not None):
            yield f"{key}: at names the places already, allowed: without between and pitch"
        for name, unit in (("between", "mm"), ("angles", "deg"), ("height_range", "mm"),
                           ("tilt_range", "deg")):  # fmt: skip
            ends = getattr(self, name)
            if ends is not None and not _ascending(ends):
                shown = _shown(np.degrees(ends) if unit == "deg" else ends)
                what = "places" if name == "between" else "ends"
                yield f"{key}.{name} = {shown} {unit}, allowed: two {what}, ascending"
        if self.angles is not None and self.angles[-1] - self.angles[0] > 2 * np.pi + 1e-9:
            yield f"{key}.angles go around more than once, allowed: at most 360 deg"
        if self.center is not None and len(self.center) != 2:
            yield f"{key}.center has {len(self.center)} numbers, allowed: x and y"
        if self.corners is not None:
            yield from polygon_problems(np.array(self.corners), f"{key}.corners")
        yield from self._direction_problems(key)
        if self.like is not None and self.like >= lamps:
            yield f"{key}.like = {self.like}, allowed: the number of a lamp, 0 to {lamps - 1}"

    def _direction_problems(self, key: str) -> Iterator[str]:
        if self.direction is not None:
            if len(self.direction) != 3 or not any(self.direction):
                yield f"{key}.direction = {_shown(self.direction)}, allowed: x, y and z, not all 0"
            for name in ("tilt", "tilt_range"):
                if getattr(self, name) is not None:
                    yield f"{key}: {name} and direction, allowed: one of the two"
        places, ways = len(self.positions or ()), len(self.directions or ())
        if self.positions is not None and self.directions is not None and places != ways:
            yield f"{key}: {places} positions and {ways} directions, allowed: as many of both"
        for number, way in enumerate(self.directions or ()):
            if not any(way):
                yield f"{key}.directions.{number} = 0, 0, 0 points nowhere, allowed: any other"


class KeepOut(Part):
    """Where no lamp may be placed: a part of an edge, or what a circle or a polygon covers.

    ``between`` are two places of an ``edge``, mm from its middle. Circles (``center``, ``radius``)
    and polygons of ``corners`` are seen along z.
    """

    edge: Edge | None = None
    between: Places | None = None
    center: Places | None = None
    radius: Distance | None = None
    corners: Corners | None = None

    def problems(self, key: str) -> Iterator[str]:
        """Yield what is wrong with it."""
        named = {name for name in type(self).model_fields if getattr(self, name) is not None}
        if named not in ({"edge", "between"}, {"center", "radius"}, {"corners"}):
            said = f"names {' and '.join(sorted(named))}" if named else "names nothing"
            yield f"{key} {said}, allowed: edge and between, center and radius, or corners"
            return
        if self.between is not None and not _ascending(self.between):
            yield f"{key}.between = {_shown(self.between)} mm, allowed: two places, ascending"
        if self.center is not None and len(self.center) != 2:
            yield f"{key}.center has {len(self.center)} numbers, allowed: x and y"
        if self.corners is not None:
            yield from polygon_problems(np.array(self.corners), f"{key}.corners")

    @property
    def words(self) -> str:
        """Where it is, for people."""
        if self.between is not None:
            low, high = self.between
            return f"between {low:g} and {high:g} mm of the {self.edge} edge"
        if self.center is not None:
            x, y = self.center
            return f"within {self.radius:g} mm of ({x:g}, {y:g}) mm"
        return f"on a polygon of {len(self.corners or ())} corners"

    def holds(self, position: Array, radius: float, edge: Edge | None) -> bool:
        """Return whether a body of ``radius`` mm at a ``position`` reaches into it.

        ``edge`` is that along which it sits, if there is one.
        """
        if self.between is not None:
            if edge != self.edge:
                return False
            low, high = self.between
            return bool(low - radius < position[int(edge in ("left", "right"))] < high + radius)
        if self.center is not None:
            assert self.radius is not None
            return bool(np.hypot(*(position[:2] - self.center)) < self.radius + radius)
        corners = np.array(self.corners)
        return bool(
            inside(position[:2], corners) or border_distance(position[:2], corners) < radius
        )


class LampCount(Part):
    """How many lit lamps are ``of`` some colors or parts together: at most ``max``, or ``exactly``.

    A part of several dies is each of them.
    """

    of: Annotated[tuple[ColorName, ...], Field(strict=False, min_length=1)]
    max: Annotated[int, Count(0, 1024)] | None = None
    exactly: Annotated[int, Count(0, 1024)] | None = None

    @property
    def most(self) -> int:
        """So many at most."""
        return next(count for count in (self.exactly, self.max) if count is not None)

    @property
    def words(self) -> str:
        """How many, of what, for people."""
        return f"{'at most' if self.exactly is None else 'exactly'} {self.most} of " + ", ".join(
            self.of
        )

    def problems(self, key: str, known: Sequence[str]) -> Iterator[str]:
        """Yield what is wrong with it, where these names are ``known``."""
        if (self.max is None) == (self.exactly is None):
            said = "names neither max nor exactly" if self.max is None else "names max and exactly"
            yield f"{key} {said}, allowed: one of the two"
        for name in dict.fromkeys(self.of):
            if name not in known:
                meant = did_you_mean(name, known)
                yield f"{key}.of = {name}, allowed: {', '.join(known)}{meant}"
            elif self.of.count(name) > 1:
                yield f"{key}.of names {name} twice, allowed: once"


class Search(Part):
    """What a search may choose beside colors, directions and powers.

    ``lamps`` is how many may be lit at once, the others stay off; ``runs`` how many runs of one
    color there may be around the rim: lit lamps that follow each other, with or without some that
    are off between them. ``places`` are rails on which lamps may sit, ``apart`` (mm) the least
    distance of their centers, or else one diameter; ``keep_out`` are parts of edges and boards
    where none may be placed. ``mirror`` is the axis along which lamps are mirrored at 0: a lamp and
    its image have one color, or both are off. ``parts`` are LEDs of the library or of
    ``[[parts]]``, one of which every lamp is; ``counts`` says of how many lamps some are. All lit
    lamps together draw ``current`` (mA) at most, and cost ``price`` (US dollars) at most.
    """

    lamps: Annotated[int, Count(1, 1024)] | None = None
    runs: Annotated[int, Count(1, 1024)] | None = None
    apart: Distance | None = None
    mirror: Literal["x", "y"] | None = None
    keep_out: Annotated[tuple[KeepOut, ...], Field(strict=False)] = ()
    places: Annotated[tuple[Rail, ...], Field(strict=False)] = ()
    parts: Annotated[tuple[str, ...], Field(strict=False)] = ()
    counts: Annotated[tuple[LampCount, ...], Field(strict=False)] = ()
    current: Annotated[float, Quantity("mA", 0.1, 100_000.0)] | None = None
    price: Annotated[float, Quantity("USD", 0.001, 100_000.0)] | None = None

    def counting_problems(self, colors: Sequence[str], entries: Sequence[str]) -> Iterator[str]:
        """Yield which names of ``counts`` are none of the scene's ``colors``.

        Where the search names parts, those and their ``entries`` are known instead.
        """
        known = list(dict.fromkeys([*self.parts, *entries])) if self.parts else colors
        for number, count in enumerate(self.counts):
            yield from count.problems(f"search.counts.{number}", known)

    def problems(self, constraints: Constraints | None, lamps: int) -> Iterator[str]:
        """Yield what is wrong with the section by itself, for a scene of so many ``lamps``."""
        if not any(getattr(self, name) for name in type(self).model_fields):
            yield f"search names nothing, allowed: {', '.join(type(self).model_fields)}"
        if self.price is not None and not self.parts:
            yield "search.price without search.parts, allowed: parts, whose prices are known"
        exact = [count for count in self.counts if count.exactly is not None]
        names = [name for count in exact for name in count.of]
        least = sum(count.most for count in exact) if len(names) == len({*names}) else 0
        if self.lamps is not None and least > self.lamps:
            yield f"search.lamps = {self.lamps}, but search.counts asks for {least}, allowed: at " \
                  f"least {least}"  # fmt: skip
        for number, rail in enumerate(self.places):
            yield from rail.problems(f"search.places.{number}", lamps)
        for number, part in enumerate(self.keep_out):
            yield from part.problems(f"search.keep_out.{number}")
        fixed = constraints.fixed if constraints is not None else ()
        lit = sum(entry.color not in (None, "off") for entry in fixed)
        if self.lamps is not None and lit > self.lamps:
            yield (
                f"search.lamps = {self.lamps}, but constraints.fixed lights {lit} lamps, allowed: "
                f"at least {lit}"
            )

    def sentences(self) -> Iterator[str]:
        """Yield what is searched, in words."""
        if self.lamps is not None:
            yield f"at most {self.lamps} lamp{'s' * (self.lamps != 1)} lit"
        if self.parts:
            yield f"lamps are of {', '.join(self.parts)}"
        if self.current is not None:
            yield f"at most {self.current:g} mA together"
        if self.price is not None:
            yield f"at most {self.price:g} US dollars together"
        if self.runs is not None:
            yield f"at most {self.runs} run{'s' * (self.runs != 1)} of one color"
        if self.mirror is not None:
            yield f"lamps in pairs mirrored at {self.mirror} = 0"
        for count in self.counts:
            yield count.words
        for rail in self.places:
            where = {"edge": "along", "ring": "on", "board": "on", "list": "on"}[rail.kind]
            yield f"lamps may sit {where} {rail.words}"
        for part in self.keep_out:
            yield f"none {part.words}"


def _ascending(places: tuple[float, ...]) -> bool:
    return len(places) == 2 and places[0] < places[1]


def _shown(places: tuple[float, ...] | Array) -> str:
    return ", ".join(f"{place:g}" for place in places)
