"""Faces of the silicone that are not like the others: as rough as an entry of the file says.

A face is one side of the flat block of silicone, diffuser included, as in
`render.scene.lamps.FACES`; it stays one when the pad bends. The far side is the coating, and no
face.

Level 2 renders them as they are. Level 0 blurs the camera's view by the roughness of the lower face
and takes that of an edge into the diffuser's response; the light of bare lamps enters clear edges
as if they were smooth, which is within 5 % (median) up to a roughness of 0.3, and 6 to 10 % too
bright at 0.5.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from render.scene.lamps import FACES
from render.scene.quantities import Part, Quantity

FaceName = Literal["left", "tip", "right", "base", "lower"]


class NamedFaces(Part):
    """The faces ``on`` which something else is than on the rest of the pad.

    ``roughness``: Beckmann alpha, in place of ``pad.roughness``; the cut edges of a pad are rougher
    than its polished window.
    """

    on: Annotated[tuple[FaceName, ...], Field(strict=False, min_length=1)]
    roughness: Annotated[float, Quantity("", 0.0, 0.5)]


@dataclass(frozen=True)
class Finish:
    """What light meets on one face: a boundary to the air of Beckmann ``roughness``, 0 smooth."""

    roughness: float


def finishes(named: tuple[NamedFaces, ...], roughness: float) -> tuple[Finish, ...]:
    """Return the finish of each of `FACES`; ``roughness`` is that of faces without a name."""
    of_face = {face: entry for entry in named for face in entry.on}
    return tuple(
        Finish(of_face[face].roughness if face in of_face else roughness) for face in FACES
    )


def face_problems(named: tuple[NamedFaces, ...]) -> Iterator[str]:
    """Yield what is wrong with faces, one sentence each."""
    seen: dict[str, str] = {}
    for number, entry in enumerate(named):
        key = f"faces.{number}.on"
        for face in entry.on:
            if face in seen:
                yield (
                    f"{key} = {face}: {seen[face]} names it already, allowed: each face once, of "
                    f"{', '.join(FACES)}"
                )
            seen.setdefault(face, key)
