"""The camera: where it stands, how it is turned, its lens and its picture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from render.scene.colors import MOST_SHOTS, ColorName
from render.scene.quantities import Count, Part, Quantity, since_schema_2

Vector = tuple[float, float, float]
Millimeters = Annotated[float, Quantity("mm", 0.01, 1000.0)]
Coordinate = Annotated[float, Quantity("mm", -1000.0, 1000.0)]
Place = Annotated[tuple[float, ...], Quantity("mm", -1000.0, 1000.0, many=True)]
Way = Annotated[tuple[float, ...], Quantity("", -1000.0, 1000.0, many=True)]

WIDEST_PINHOLE, WIDEST_CORNER = 175.0, 175.0
"""deg: full field of view of a pinhole over its rows, and angle of a fisheye's corners from its
axis."""
MOST_PIXELS = 4096
"""Of a picture's columns, and of its rows."""
READ_BY_CAMERA = (
    "read_noise", "full_well", "bits", "saturated", "longest_exposure", "gains",
)  # fmt: skip
"""Keys of a camera that change what is read of its light, and no light."""
TIMES = ("exposure_time", "line_time")
"""Keys of a camera that say how long a picture takes, and change no light."""
AHEAD, UP = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)


class Camera(Part):
    """A camera in air below the pad; its pixels are square, and rows count from the top.

    It stands at ``position``, or at (0, ``y``, -``distance``), and looks in ``direction`` or at the
    point ``look_at``; by default straight at the coating (+z). ``up`` is turned to the top of the
    picture, by default towards the tip (+y); columns then run towards -x. ``field_of_view`` is the
    full angle over all rows. A ``pinhole`` shows the tangent of the angle from its axis, a
    ``fisheye`` the angle itself (equidistant). ``channels`` are its colors, by default red, green
    and blue. ``shots`` pictures are taken one after the other, each under lights of its own; all
    together last as long as one may.

    What limits readers of its pictures changes no light: ``read_noise`` (one standard deviation in
    counts of 255 at gain 1), ``full_well`` (photoelectrons at 255 counts and gain 1), ``bits``,
    ``longest_exposure`` in units of the scene's own exposure, ``gains`` that it has (any above 1
    unless named), and ``saturated``, the part of all colors that may reach full scale. Bands of
    LEDs that dim by pulses follow from ``exposure_time`` (ms, of the scene's own exposure) and
    ``line_time`` (us between rows of a rolling shutter).
    """

    distance: Millimeters | None = None
    y: Coordinate | None = None
    field_of_view: Annotated[float, Quantity("deg", 1.0, 300.0)]
    columns: Annotated[int, Count(8, MOST_PIXELS)]
    rows: Annotated[int, Count(8, MOST_PIXELS)]
    position: Place | None = since_schema_2()
    look_at: Place | None = since_schema_2()
    direction: Way | None = since_schema_2()
    up: Way | None = since_schema_2()
    lens: Literal["pinhole", "fisheye"] | None = since_schema_2()
    channels: Annotated[tuple[ColorName, ...], Field(strict=False, min_length=1)] | None = (
        since_schema_2()
    )
    shots: Annotated[int, Count(1, MOST_SHOTS)] | None = since_schema_2()
    read_noise: Annotated[float, Quantity("counts", 0.0, 50.0)] | None = since_schema_2()
    full_well: Annotated[float, Quantity("electrons", 100.0, 1e7)] | None = since_schema_2()
    bits: Annotated[int, Count(4, 16)] | None = since_schema_2()
    longest_exposure: Annotated[float, Quantity("", 0.01, 1000.0)] | None = since_schema_2()
    gains: Annotated[tuple[float, ...], Quantity("", 1.0, 1000.0, many=True)] | None = (
        since_schema_2()
    )
    saturated: Annotated[float, Quantity("", 0.0, 0.5)] | None = since_schema_2()
    exposure_time: Annotated[float, Quantity("ms", 0.001, 60_000.0)] | None = since_schema_2()
    line_time: Annotated[float, Quantity("us", 0.0, 10_000.0)] | None = since_schema_2()

    @property
    def place(self) -> Vector:
        """Where the camera stands, mm, the same at every bend."""
        if self.position is not None:
            x, y, z = self.position
            return x, y, z
        assert self.y is not None
        assert self.distance is not None
        return 0.0, self.y, -self.distance

    @property
    def pivot(self) -> float:
        """The y (mm) of the camera, at which a bent pad touches the plane of the flat one."""
        return self.place[1]

    @property
    def axes(self) -> tuple[Vector, Vector, Vector]:
        """Unit vectors to the right and down in the picture, and straight ahead."""
        ahead = _unit(self._ahead)
        right = _unit(_cross(ahead, self.up or UP))
        return right, _cross(ahead, right), ahead

    @property
    def fisheye(self) -> bool:
        """Whether the lens is no pinhole."""
        return self.lens == "fisheye"

    @property
    def corner_angle(self) -> float:
        """The angle (rad) of a fisheye's corners from its axis."""
        return 0.5 * self.field_of_view * math.hypot(1.0, self.columns / self.rows)

    @property
    def _ahead(self) -> tuple[float, ...]:
        if self.look_at is not None:
            return tuple(a - b for a, b in zip(self.look_at, self.place, strict=True))
        return self.direction or AHEAD

    def problems(self) -> Iterator[str]:
        """Yield a sentence for everything that does not fit together."""
        vectors = {name: getattr(self, name) for name in ("position", "look_at", "direction", "up")}
        short = {name: v for name, v in vectors.items() if v is not None and len(v) != 3}
        for name, values in short.items():
            many = "s" * (len(values) != 1)
            yield f"camera.{name} has {len(values)} value{many}, allowed: 3 (x, y, z)"
        old = [name for name in ("distance", "y") if getattr(self, name) is not None]
        if self.position is not None and old:
            yield f"camera.{old[0]} and camera.position both place the camera, allowed: one of them"
        missing = [name for name in ("distance", "y") if getattr(self, name) is None]
        if self.position is None and missing:
            yield f"missing key camera.{missing[0]}"
        if self.look_at is not None and self.direction is not None:
            yield "camera.look_at and camera.direction both turn the camera, allowed: one of them"
        if not short and (self.position is not None or not missing):
            yield from self._pose_problems()
        angle = math.degrees(self.field_of_view)
        if not self.fisheye and angle > WIDEST_PINHOLE + 1e-9:
            yield (
                f"camera.field_of_view = {angle:g} deg, allowed: 1 to {WIDEST_PINHOLE:g} deg for a "
                'pinhole; a wider lens is lens = "fisheye"'
            )
        if self.fisheye and math.degrees(self.corner_angle) > WIDEST_CORNER + 1e-9:
            widest = angle * WIDEST_CORNER / math.degrees(self.corner_angle)
            yield (
                f"camera.field_of_view = {angle:g} deg turns the corners of {self.columns} x "
                f"{self.rows} pixels to {math.degrees(self.corner_angle):.4g} deg from the axis, "
                f"allowed: at most {widest:.4g} deg"
            )

    def _pose_problems(self) -> Iterator[str]:
        if self.place[2] >= 0.0:
            yield (
                f"camera.position has z = {self.place[2]:g} mm, which is not below the pad, "
                "allowed: below 0 mm, where the pad's face on the camera's side is"
            )
        ahead, up = self._ahead, self.up or UP
        if math.hypot(*ahead) == 0.0:
            name = "look_at is camera.position" if self.look_at is not None else "direction is 0"
            yield f"camera.{name}, allowed: anywhere else"
        elif math.hypot(*_cross(ahead, up)) <= 1e-6 * math.hypot(*ahead) * math.hypot(*up):
            yield (
                f"camera.up = {_shown(up)} lies along the way that the camera looks, "
                f"{_shown(ahead)}, allowed: across it"
            )

    @model_serializer(mode="wrap")
    def _as_schema_1_where_it_can(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Say a straight pinhole as schema 1 does, so that it has the same hash."""
        content: dict[str, Any] = handler(self)
        x, y, z = self.place
        straight = self.axes == ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), AHEAD) and not self.fisheye
        if straight and x == 0.0:
            for name in ("position", "look_at", "direction", "up", "lens"):
                content.pop(name, None)
            content |= {"distance": -z, "y": y}
        return content


def _cross(a: tuple[float, ...], b: tuple[float, ...]) -> Vector:
    # Adding 0 turns -0.0 into 0.0.
    return (
        a[1] * b[2] - a[2] * b[1] + 0.0,
        a[2] * b[0] - a[0] * b[2] + 0.0,
        a[0] * b[1] - a[1] * b[0] + 0.0,
    )


def _unit(vector: tuple[float, ...]) -> Vector:
    length = math.hypot(*vector)
    x, y, z = (value / length for value in vector)
    return x, y, z


def _shown(vector: tuple[float, ...]) -> str:
    return f"({', '.join(f'{value:g}' for value in vector)})"
