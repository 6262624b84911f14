"""What a search may decide beyond colors and directions: an optional section of the scene file.

Where lamps may sit, and how many may be lit. It says which designs may be chosen, not what light
does, so it has no part in the scene's hash.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from render.scene.constraints import Constraints
from render.scene.lamps import Edge
from render.scene.quantities import Count, Part, Quantity

Places = Annotated[tuple[float, ...], Quantity("mm", -1000.0, 1000.0, many=True)]
Distance = Annotated[float, Quantity("mm", 0.05, 100.0)]


class Rail(Part):
    """Places along one ``edge`` on which lamps may sit.

    They lie ``between`` two places (mm from the edge's middle, towards the tip or the right), a
    ``pitch`` apart; or ``at`` given ones. Without these they fill the whole edge, two diameters
    apart. Lamps are like one of the scene's: ``like`` is its number, or else it is the one nearest
    to the edge's middle. ``heights`` (mm, of centers over the lower face), ``gap`` and ``tilt`` are
    as rows have them, or else those of that lamp, and the heights of all on its edge.
    """

    edge: Edge
    between: Places | None = None
    at: Places | None = None
    pitch: Distance | None = None
    heights: Annotated[tuple[float, ...], Quantity("mm", -100.0, 100.0, many=True)] | None = None
    gap: Annotated[float, Quantity("mm", -100.0, 100.0)] | None = None
    tilt: Annotated[float, Quantity("deg", -89.0, 89.0)] | None = None
    like: Annotated[int, Count(0, 1023)] | None = None

    def problems(self, key: str, lamps: int) -> Iterator[str]:
        """Yield what is wrong with the rail by itself; the scene has so many ``lamps``."""
        if self.at is not None and (self.between is not None or self.pitch is not None):
            yield f"{key}: at names the places already, allowed: without between and pitch"
        if self.between is not None and not _ascending(self.between):
            yield f"{key}.between = {_shown(self.between)} mm, allowed: two places, ascending"
        if self.like is not None and self.like >= lamps:
            yield f"{key}.like = {self.like}, allowed: the number of a lamp, 0 to {lamps - 1}"


class KeepOut(Part):
    """Where no lamp may be placed: ``between`` two places of an ``edge``, mm from its middle."""

    edge: Edge
    between: Places

    def problems(self, key: str) -> Iterator[str]:
        """Yield what is wrong with it."""
        if not _ascending(self.between):
            yield f"{key}.between = {_shown(self.between)} mm, allowed: two places, ascending"

    def holds(self, place: float, radius: float) -> bool:
        """Return whether a body of ``radius`` mm at a ``place`` of the edge reaches into it."""
        low, high = self.between
        return low - radius < place < high + radius


class Search(Part):
    """What a search may choose beside colors, directions and powers.

    ``lamps`` is how many may be lit at once, the others stay off; ``runs`` how many runs of one
    color there may be around the rim: lit lamps that follow each other, with or without some that
    are off between them. ``places`` are rails on which lamps may sit, ``apart`` (mm) the least
    distance of their centers, or else one diameter; ``keep_out`` are parts of edges where none may
    be placed. ``parts`` are LEDs of the library or of ``[[parts]]``, one of which every lamp is.
    All lit lamps together draw ``current`` (mA) at most, and cost ``price`` (US dollars) at most.
    """

    lamps: Annotated[int, Count(1, 1024)] | None = None
    runs: Annotated[int, Count(1, 1024)] | None = None
    apart: Distance | None = None
    keep_out: Annotated[tuple[KeepOut, ...], Field(strict=False)] = ()
    places: Annotated[tuple[Rail, ...], Field(strict=False)] = ()
    parts: Annotated[tuple[str, ...], Field(strict=False)] = ()
    current: Annotated[float, Quantity("mA", 0.1, 100_000.0)] | None = None
    price: Annotated[float, Quantity("USD", 0.001, 100_000.0)] | None = None

    def problems(self, constraints: Constraints | None, lamps: int) -> Iterator[str]:
        """Yield what is wrong with the section by itself, for a scene of so many ``lamps``."""
        if not self.model_fields_set:
            yield f"search names nothing, allowed: {', '.join(type(self).model_fields)}"
        if self.price is not None and not self.parts:
            yield "search.price without search.parts, allowed: parts, whose prices are known"
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
        for rail in self.places:
            yield f"lamps may sit along the {rail.edge} edge"
        for part in self.keep_out:
            low, high = part.between
            yield f"none between {low:g} and {high:g} mm of the {part.edge} edge"


def _ascending(places: tuple[float, ...]) -> bool:
    return len(places) == 2 and places[0] < places[1]


def _shown(places: tuple[float, ...]) -> str:
    return ", ".join(f"{place:g}" for place in places)
