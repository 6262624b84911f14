"""Faces of the silicone that are not like the others: rougher, or painted.

A face is one side of the flat block of silicone, diffuser included, as in
`render.scene.lamps.FACES`; it stays one when the pad bends. The far side is the coating, and no
face.

The reference renders them as they are. The preview blurs the camera's view by the roughness of the
lower face and takes that of an edge into the diffuser's response; the light of bare lamps enters
clear edges as if they were smooth, which is within 5 % (median) up to a roughness of 0.3, and 6 to
10 % too bright at 0.5.

Edges may have a diffuser each (``diffuser.on``); paint lies on others.

Paint touches the silicone: there is no air between, so nothing is reflected before it. It lets
nothing through, and its other side is black.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from render.scene.lamps import FACES, Edge, PlacedLamp
from render.scene.quantities import Part, Quantity

FaceName = Literal["left", "tip", "right", "base", "lower"]
Reflectance = Annotated[float, Quantity("", 0.0, 1.0)]
KINDS = ("roughness", "black", "white", "mirror")
"""What an entry of the file says of its faces: one of these."""


class NamedFaces(Part):
    """The faces ``on`` which something else is than on the rest of the pad, one of four.

    ``roughness``: Beckmann alpha, in place of ``pad.roughness``; the cut edges of a pad are rougher
    than its polished window. ``black``: paint that absorbs all light. ``white``: paint that is
    Lambertian, of this albedo. ``mirror``: metal of this reflectance, at any angle.
    """

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": [kind]} for kind in KINDS]})

    on: Annotated[tuple[FaceName, ...], Field(strict=False, min_length=1)]
    roughness: Annotated[float, Quantity("", 0.0, 0.5)] | None = None
    black: Literal[True] | None = None
    white: Reflectance | None = None
    mirror: Reflectance | None = None

    @property
    def kinds(self) -> list[str]:
        """Which of `KINDS` the entry names."""
        return [name for name in KINDS if getattr(self, name) is not None]

    def finish(self, roughness: float) -> Finish:
        """Return what light meets there; ``roughness`` is that of the pad."""
        if self.white is not None or self.mirror is not None or self.black:
            reflectance = self.white or self.mirror or 0.0
            return Finish(roughness, Paint(reflectance, bool(self.mirror)))
        return Finish(roughness if self.roughness is None else self.roughness)


@dataclass(frozen=True)
class Paint:
    """What lies on a face in place of air: it sends back ``reflectance`` of the light.

    A ``mirror`` does so like one, other paint in all directions (Lambertian).
    """

    reflectance: float
    mirror: bool

    @property
    def word(self) -> str:
        """What people call it."""
        return "mirror" if self.mirror else "white" if self.reflectance > 0 else "black"


@dataclass(frozen=True)
class Finish:
    """What light meets on one face: a boundary to the air of Beckmann ``roughness``, 0 smooth.

    Where there is ``paint`` it meets that, and the roughness says nothing.
    """

    roughness: float
    paint: Paint | None = None

    @property
    def smooth(self) -> bool:
        """Whether it is a smooth boundary to the air."""
        return self.paint is None and self.roughness == 0.0

    @property
    def white(self) -> bool:
        """Whether it sends light back to all sides."""
        return self.paint is not None and self.paint.word == "white"

    @property
    def metal(self) -> float | None:
        """What it reflects where it is a mirror of metal; None: it is none."""
        return self.paint.reflectance if self.paint is not None and self.paint.mirror else None

    @property
    def content(self) -> dict[str, float | bool]:
        """What the hash of a scene has of it."""
        return {"roughness": self.roughness} if self.paint is None else asdict(self.paint)


def finishes(named: tuple[NamedFaces, ...], roughness: float) -> tuple[Finish, ...]:
    """Return the finish of each of `FACES`; ``roughness`` is that of faces without a name."""
    of_face = {face: entry for entry in named for face in entry.on}
    return tuple(
        of_face[face].finish(roughness) if face in of_face else Finish(roughness) for face in FACES
    )


def face_problems(named: tuple[NamedFaces, ...], diffuser: tuple[Edge, ...]) -> Iterator[str]:
    """Yield what is wrong with faces, one sentence each; ``diffuser`` names its edges."""
    free = ", ".join(face for face in FACES if face not in diffuser and face != "lower")
    seen: dict[str, str] = {}
    for number, entry in enumerate(named):
        key = f"faces.{number}.on"
        if len(entry.kinds) != 1:
            yield (
                f"faces.{number} names {' and '.join(entry.kinds) or 'nothing'}, allowed: one of "
                f"{', '.join(KINDS)}"
            )
        painted = entry.finish(0.0).paint
        for face in entry.on:
            if face in seen:
                yield (
                    f"{key} = {face}: {seen[face]} names it already, allowed: each face once, of "
                    f"{', '.join(FACES)}"
                )
            seen.setdefault(face, key)
            if painted and face == "lower":
                yield f"{key} = lower: the camera looks through it, allowed: paint on edges"
            elif painted and face in diffuser:
                yield (
                    f"{key} = {face}: a diffuser lies on that edge, allowed: paint on "
                    f"{free or 'none, as it lies on all'}"
                )


def painted_lamp_problems(
    lamps: tuple[PlacedLamp, ...], finishes: tuple[Finish, ...]
) -> Iterator[str]:
    """Yield which lamps shine at paint, one sentence for each row, list entry and face."""
    told = set()
    for lamp in lamps:
        paint = None if lamp.solid else finishes[lamp.face].paint
        if paint is not None and (lamp.key, lamp.face) not in told:
            told.add((lamp.key, lamp.face))
            face = FACES[lamp.face]
            free = [name for name, one in zip(FACES, finishes, strict=True) if one.paint is None]
            yield (
                f"{lamp.key} shines at the {face} face, which is painted ({paint.word}): no light "
                f"comes in, allowed: lamps before {', '.join(free)}"
            )
