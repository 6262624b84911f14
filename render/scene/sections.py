"""The plain sections of a scene: pad, diffuser, window, coating, bends, sites, pyramid, baseline.

Lengths are mm, angles radians and coefficients 1/mm, all float64.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, model_validator
from pydantic.json_schema import SkipJsonSchema
from pydantic_core import PydanticCustomError

from render.arrays import Array
from render.errors import SceneError
from render.refused_values import did_you_mean
from render.scene.camera import Coordinate, Millimeters
from render.scene.colors import OFF, RGB
from render.scene.lamps import EDGES, RIM_EDGES, Edge
from render.scene.quantities import Count, Part, PerChannel, Quantity, since_schema_2, unchecked


def _known_color(value: str, info: ValidationInfo) -> str:
    """Refuse a color that the file does not have; the context names those that it has."""
    known = (info.context or {}).get("colors", RGB.names)
    if value not in known:
        allowed = ", ".join(known) + did_you_mean(value, known)
        raise PydanticCustomError("unknown_color", "allowed: {allowed}", {"allowed": allowed})
    return value


KnownColor = Annotated[str, AfterValidator(_known_color)]


def _edge_colors(value: Any, info: ValidationInfo) -> str | tuple[str, ...]:
    """Return the color of all lamps on an edge, or one for each of them."""
    alone = isinstance(value, str)
    if not alone and not (isinstance(value, list | tuple) and all(type(c) is str for c in value)):
        raise PydanticCustomError(
            "edge_colors", "allowed: a color, or a list of one for each lamp of the edge"
        )
    for color in [value] if alone else value:
        _known_color(color, info)
    return value if alone else tuple(value)


EdgeColors = Annotated[str | tuple[str, ...], BeforeValidator(_edge_colors)]


ROUNDING = 1e-9
"""By which reflectances may be more than 1 together."""
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
            return unchecked(self, {"sigma_s": value / (1.0 - self.g)})
        return unchecked(self, {"thickness": value})


class Window(Part):
    """A clear plate under the pad, bonded to its lower face and of its outline.

    It reaches from z = 0 down to -``thickness``, and the camera looks through it. The face
    ``lower`` is its lower one; its edges are finished as the pad's above them, and lamps with a
    height below 0 shine into them.
    """

    thickness: Millimeters
    index: Annotated[float, Quantity("", 1.2, 1.9)]


class Coating(Part):
    """The far side of the pad, seen from inside: Lambertian, with a specular lobe where named.

    ``albedo`` is the part of the light that it scatters by Lambert's law: one number, or one per
    camera channel, for skins of pigment have a color. ``specular`` is the part that goes into the
    lobe: that of microfacets which reflect everything, ``roughness`` (Beckmann alpha) as of the
    pad's faces.
    """

    albedo: Annotated[
        float | tuple[float, ...],
        PerChannel("", 0.0, 1.0),
        Field(json_schema_extra={"lists_since_schema": 2}),
    ]
    specular: Annotated[float, Quantity("", 0.0, 1.0)] | None = since_schema_2()
    roughness: Annotated[float, Quantity("", 0.05, 0.5)] | None = since_schema_2()

    @property
    def single_albedo(self) -> float:
        """The albedo of all channels.

        Raises:
            SceneError: it differs by channel, and who asks follows light of one albedo at a time.
        """
        if isinstance(self.albedo, float):
            return self.albedo
        shown = ", ".join(f"{value:g}" for value in self.albedo)
        raise SceneError(
            f"coating.albedo = {shown} differs by channel, allowed here: one number for all "
            "channels; give their mean, or use a command that docs/limits.md does not exclude",
            field="coating.albedo",
        )

    @property
    def lobe(self) -> tuple[float, float] | None:
        """Reflectance and roughness of the lobe; None where nothing goes into one."""
        if not self.specular or self.roughness is None:
            return None
        return self.specular, self.roughness

    @property
    def reflectance(self) -> float:
        """What it sends back of the light that arrives, but for what microfacets mask."""
        return self.single_albedo if self.lobe is None else self.single_albedo + self.lobe[0]

    def problems(self, channels: tuple[str, ...]) -> Iterator[str]:
        """Yield what is wrong with it, or does not fit a camera with ``channels``."""
        if (self.specular is None) != (self.roughness is None):
            named, other = ("specular", "roughness")[:: 1 if self.roughness is None else -1]
            yield (
                f"coating.{named}: there is no coating.{other}, allowed: both or none; a lobe has "
                "a reflectance and a roughness"
            )
        brightest = self.albedo if isinstance(self.albedo, float) else max(self.albedo, default=0.0)
        if brightest + (self.specular or 0.0) > 1.0 + ROUNDING:
            yield (
                f"coating.specular = {self.specular:g} and coating.albedo = {brightest:g} send "
                f"back more light than arrives, allowed: at most {1.0 - brightest:g} for "
                "specular, together at most 1"
            )
        if isinstance(self.albedo, float):
            return
        if len(self.albedo) != len(channels):
            given = len(self.albedo)
            yield (
                f"coating.albedo has {given} value{'s' * (given != 1)}, allowed: one number, or "
                f"{len(channels)}, one per channel ({', '.join(channels)})"
            )
        for channel, value in zip(channels, self.albedo, strict=False):
            if value == 0.0 and any(self.albedo):
                yield (
                    f"coating.albedo = 0 in channel {channel}, allowed in a list: above 0; leave a "
                    "channel that sees nothing out of camera.channels"
                )


class Bending(Part):
    """The total bending angles that are tested; the pad is a circular arc."""

    angles: Annotated[tuple[float, ...], Quantity("deg", 0.0, 180.0, many=True)]

    @property
    def rigid(self) -> bool:
        """Whether the pad is flat at all times."""
        return not any(self.angles)


class CarriedSites(Part):
    """Sites as a state of the skin carries them, ``(site,)`` each; no file names them.

    ``x`` and ``y`` in mm, ``turn`` in rad about the skin's normal. ``counted`` are the numbers of
    those that count in all states; None where that is up to this one.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]
    turn: tuple[float, ...]
    counted: tuple[int, ...] | None = None

    @model_validator(mode="before")
    @classmethod
    def _not_in_files(cls, _raw: Any) -> Any:
        raise ValueError("no scene file has this key, allowed: none")


class Sites(Part):
    """The grid of test contacts on the coating: ``columns`` across x, ``rows`` along y."""

    columns: Annotated[int, Count(1, 32)]
    rows: Annotated[int, Count(1, 64)]
    spacing: Millimeters
    centre_x: Coordinate
    centre_y: Coordinate
    carried: SkipJsonSchema[CarriedSites | None] = None

    @property
    def count(self) -> int:
        """Number of sites."""
        return self.columns * self.rows

    @property
    def places(self) -> Array:
        """Flat x and y of the sites, ``(site, 2)`` mm, row by row from the base."""
        if self.carried is not None:
            return np.stack([self.carried.x, self.carried.y], axis=-1)
        x = self.centre_x + (np.arange(self.columns) - (self.columns - 1) / 2) * self.spacing
        y = self.centre_y + (np.arange(self.rows) - (self.rows - 1) / 2) * self.spacing
        grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
        return np.stack([grid_x.ravel(), grid_y.ravel()], axis=-1)

    @property
    def turns(self) -> Array:
        """Rotation of the sites about the skin's normal, ``(site,)`` rad."""
        return np.zeros(self.count) if self.carried is None else np.array(self.carried.turn)


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
    """The colors of the design that others are compared with (thesis 5.1).

    An edge has one color, or a list of one for each of its lamps, in the order of their numbers:
    ``left`` from base to tip, ``tip`` from left to right, ``right`` from tip to base, ``base`` from
    right to left. ``lamps`` are the colors of listed lamps, one by one.
    """

    left: EdgeColors | None = None
    tip: EdgeColors | None = None
    right: EdgeColors | None = None
    base: EdgeColors | None = since_schema_2()
    lamps: Annotated[tuple[KnownColor, ...], Field(strict=False)] | None = since_schema_2()

    def problems(self, lit: Mapping[str, int], listed: int, every_edge: bool) -> Iterator[str]:
        """Yield what is missing or too much for lamps on ``lit`` edges and ``listed`` ones."""
        needed = {*lit, "left", "tip", "right"} if every_edge else {*lit}
        for edge in EDGES:
            colors, count = getattr(self, edge), lit.get(edge, 0)
            if edge in needed and colors is None:
                yield f"missing key baseline.{edge}"
            elif edge not in needed and colors is not None:
                yield f"baseline.{edge}: no row of lamps is on that edge, leave it out"
            elif isinstance(colors, tuple) and len(colors) != count:
                yield (
                    f"baseline.{edge} names {len(colors)} colors, allowed: {count}, one for each "
                    "lamp of the edge, or one color alone"
                )
        named = [getattr(self, edge) or () for edge in EDGES]
        every = {c for one in named for c in ([one] if isinstance(one, str) else one)}
        if every | {*(self.lamps or ())} == {OFF}:
            yield (
                "baseline: all lamps are off, allowed: at least one that shines; its picture sets "
                "the exposure, and designs are compared with it"
            )
        if len(self.lamps or ()) != listed:
            yield (
                f"baseline.lamps names {len(self.lamps or ())} colors, allowed: {listed}, one for "
                "each listed lamp"
            )
