"""The shape of a skin that is not flat: its height over the pad, by a formula or a mesh.

The pad stays a block with a plane lower face and plane edges. Its upper side is the skin, a
function of x and y (mm): `Skin.rise` above `pad.thickness`, which is the height of its crown. Edges
end where the skin meets them.

How to add a shape: write a subclass of `SkinShape` with its keys, its rise and its slope, and what
makes it impossible; name it in `SHAPES` and in the choices of ``Skin.shape``; keys that no other
shape has become optional fields of `Skin`. Nothing else knows a shape: sites, probes, meshes,
camera, preview and drawing ask `render.geometry.chart`, which asks here, and the tests of the chart
run over all `SHAPES`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

import numpy as np

from render.arrays import Array
from render.scene.quantities import Part, Quantity
from render.scene.skin_mesh import OUTLINE, MeshHeights

LEAST_EDGE = 0.1
"""Height (mm) that the skin leaves of every edge."""
STEEPEST = math.radians(75.0)
"""Slope of the skin at its border at most."""
GRID = 65
"""Places along x and y at which heights are checked."""


class Skin(Part):
    """The skin of a pad that is not flat; ``pad.thickness`` is the height of its crown.

    ``shape`` is a ``dome``, part of a sphere whose center lies below the middle of the pad.
    An ``arch`` is part of a cylinder about an axis below the middle. ``radius`` is that of sphere
    or cylinder. ``axis`` of an arch is ``x`` or ``y``, the direction that its skin is straight in.
    A ``mesh`` is the upper side of a closed body from a file.
    """

    shape: Literal["dome", "arch", "mesh"]
    radius: Annotated[float, Quantity("mm", 1.0, 10000.0)] | None = None
    axis: Literal["x", "y"] | None = None
    mesh: MeshHeights | None = None

    def rise(self, x: Array, y: Array) -> Array:
        """Return the height (mm) at ``x, y`` (mm) above that of the crown, 0 or less."""
        return SHAPES[self.shape].rise(self, x, y)

    def slope(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the derivatives of `rise` along x and y."""
        return SHAPES[self.shape].slope(self, x, y)

    def grid(self, width: float, length: float) -> tuple[Array, Array]:
        """Return x and y ``(GRID, GRID)`` of places all over a pad, its border among them."""
        x, y = (np.linspace(-0.5, 0.5, GRID) * side for side in (width, length))
        return np.meshgrid(x, y)[0], np.meshgrid(x, y)[1]

    def problems(self, width: float, length: float, thickness: float) -> Iterator[str]:
        """Yield what is wrong with the skin of a pad, one sentence each; mm."""
        shape = SHAPES[self.shape]
        known = {name for name in type(self).model_fields if name != "shape"}
        named = {name for name in known if getattr(self, name) is not None}
        for name in sorted(shape.keys - named):
            yield f"missing key skin.{name}"
        for name in sorted(named - shape.keys):
            yield f"skin.{name}: a {self.shape} has none, leave it out"
        if shape.keys <= named:
            yield from shape.problems(self, np.array([width, length, thickness]))


class SkinShape(ABC):
    """One shape: a height over the pad's rectangle that is highest, 0, somewhere in it.

    Arguments:
        keys: of `Skin`, beside ``shape``, all of which a file must name.
    """

    keys: ClassVar[frozenset[str]]

    @abstractmethod
    def rise(self, skin: Skin, x: Array, y: Array) -> Array:
        """Return the height (mm) at ``x, y`` (mm) above that of the crown; finite anywhere."""

    @abstractmethod
    def slope(self, skin: Skin, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the derivatives of `rise` along x and y."""

    @abstractmethod
    def problems(self, skin: Skin, size: Array) -> Iterator[str]:
        """Yield why there is no such skin on a pad of ``size`` ``(3,)`` mm."""


class Dome(SkinShape):
    """Part of a sphere: ``rise = sqrt(R^2 - x^2 - y^2) - R``."""

    keys = frozenset({"radius"})

    def rise(self, skin: Skin, x: Array, y: Array) -> Array:
        """Return the sphere's height."""
        return round_rise(skin, x**2 + y**2)

    def slope(self, skin: Skin, x: Array, y: Array) -> tuple[Array, Array]:
        """Return its derivatives."""
        steep = round_slope(skin, x**2 + y**2)
        return steep * x, steep * y

    def problems(self, skin: Skin, size: Array) -> Iterator[str]:
        """Yield that the sphere ends within the pad."""
        yield from round_problems(skin, float(np.hypot(*size[:2])) / 2, size)


class Arch(SkinShape):
    """Part of a cylinder about an axis along x or y: ``rise = sqrt(R^2 - d^2) - R``."""

    keys = frozenset({"radius", "axis"})

    def rise(self, skin: Skin, x: Array, y: Array) -> Array:
        """Return the cylinder's height."""
        x, y = np.broadcast_arrays(x, y)
        return round_rise(skin, (y if skin.axis == "x" else x) ** 2)

    def slope(self, skin: Skin, x: Array, y: Array) -> tuple[Array, Array]:
        """Return its derivatives: none along its axis."""
        x, y = np.broadcast_arrays(x, y)
        across = y if skin.axis == "x" else x
        steep = round_slope(skin, across**2) * across
        straight = np.zeros_like(steep)
        return (straight, steep) if skin.axis == "x" else (steep, straight)

    def problems(self, skin: Skin, size: Array) -> Iterator[str]:
        """Yield that the cylinder ends within the pad."""
        yield from round_problems(skin, size[1 if skin.axis == "x" else 0] / 2, size)


def round_rise(skin: Skin, squared: Array) -> Array:
    """Return the height of an arc of ``skin.radius`` at a ``squared`` distance from its crown.

    Written without a difference of large numbers; behind the arc's end it is that of the end.
    """
    radius = skin.radius or 0.0
    squared = np.minimum(squared, (radius * math.sin(STEEPEST)) ** 2)
    return np.asarray(-squared / (radius + np.sqrt(radius**2 - squared)))


def round_slope(skin: Skin, squared: Array) -> Array:
    """Return the derivative of `round_rise` by the distance, over the distance."""
    radius = skin.radius or 0.0
    end = (radius * math.sin(STEEPEST)) ** 2
    inside = np.asarray(squared) <= end
    return np.where(inside, -1.0 / np.sqrt(radius**2 - np.minimum(squared, end)), 0.0)


def round_problems(skin: Skin, reach: float, size: Array) -> Iterator[str]:
    """Yield that an arc is too tight for a pad of ``size`` that it spans up to ``reach`` (mm)."""
    room = size[2] - LEAST_EDGE
    least = reach / math.sin(STEEPEST)
    if room < reach:
        least = max(least, (reach**2 + room**2) / (2 * room))
    if skin.radius is not None and skin.radius < least:
        yield (
            f"skin.radius = {skin.radius:g} mm is too tight for a pad of {size[0]:g} x {size[1]:g} "
            f"x {size[2]:g} mm: the skin ends within it, allowed: at least "
            f"{math.ceil(100 * least) / 100:g} mm"
        )


class MeshSkin(SkinShape):
    """The upper side of a closed body from a file (`render.scene.skin_mesh`)."""

    keys = frozenset({"mesh"})

    def rise(self, skin: Skin, x: Array, y: Array) -> Array:
        """Return the spline through the samples."""
        assert skin.mesh is not None
        return skin.mesh.rise(x, y)

    def slope(self, skin: Skin, x: Array, y: Array) -> tuple[Array, Array]:
        """Return its derivatives."""
        assert skin.mesh is not None
        return skin.mesh.slope(x, y)

    def problems(self, skin: Skin, size: Array) -> Iterator[str]:
        """Yield that the body is not the pad's size, too steep, or lower than its edges may be."""
        assert skin.mesh is not None
        sides = np.array(skin.mesh.sides)
        if np.abs(sides - size[:2]).max() > OUTLINE:
            yield (
                f"skin.mesh is {sides[0]:.4g} x {sides[1]:.4g} mm, allowed: the pad's "
                f"{size[0]:g} x {size[1]:g} mm, to {OUTLINE:g} mm"
            )
            return
        x, y = skin.grid(*size[:2])
        steepest = float(np.hypot(*self.slope(skin, x, y)).max())
        if steepest > math.tan(STEEPEST):
            yield (
                f"skin.mesh slopes by {math.degrees(math.atan(steepest)):.3g} deg, allowed: up to "
                f"{math.degrees(STEEPEST):g} deg"
            )
        lowest = float(size[2] + self.rise(skin, x, y).min())
        if lowest < LEAST_EDGE:
            yield (
                f"skin.mesh falls to {lowest:.3g} mm over the lower face under a crown of "
                f"pad.thickness = {size[2]:g} mm, allowed: at least {LEAST_EDGE:g} mm"
            )


SHAPES: dict[str, SkinShape] = {"dome": Dome(), "arch": Arch(), "mesh": MeshSkin()}
"""All shapes by their names in files."""
