"""Lamps cast into a flat pad or into its window of another index, joined over facing walls.

Each image of ``LampImages`` is seen straight, in the bond of pad and window, or through the bond in
the window's lower face, to which the bond may throw it back a few times. The last is a way through
layers of two indices, which the bond bends (``render.cells.bond_optics``), and walls reflect it on
either side of the bond.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.cells.bond_optics import WindowBond, through_bond, way_spread, way_through_bond
from render.cells.bonded_images import BondedImages
from render.cells.fiber_light import FiberLight, LampRay
from render.cells.lamp_cells import DEPTHS, IN_WINDOW, THROUGH_BOND, TURNS, met_until
from render.cells.lamp_images import LampImages
from render.cells.mirror_images import FoldedWay, MirrorImages
from render.paths.vertex import Vertex
from render.scene import Scene


@dataclass
class _Layers:
    """What light to an image goes through (a Dr.Jit PyTree).

    It goes ``through`` the bond or not, to a lamp ``in_window`` or back to the pad; ``lower`` and
    ``upper`` are how often the window's faces reflect it.
    """

    through: mi.Bool
    in_window: mi.Bool
    lower: mi.Int32
    upper: mi.Int32


class BondedLampImages(LampImages):
    """The images of all lamps in a flat pad over a window of another index, and in the window."""

    mirrors: BondedImages

    def __init__(self, scene: Scene, light: FiberLight) -> None:
        """List the images and weigh them, with the bond."""
        self.bond = WindowBond(scene)
        super().__init__(scene, light)

    def _mirrors(self, scene: Scene) -> MirrorImages:
        return BondedImages(scene)

    def _strengths(
        self, scene: Scene, lamp: int, images: np.ndarray, cells: np.ndarray
    ) -> np.ndarray:
        """Return what each near image sends; lamps in pad and window have cells of their own."""
        strength = super()._strengths(scene, lamp, images, cells)
        in_window = scene.placed_lamps()[lamp].solid == "window"
        return np.where((cells[:, 2] <= -IN_WINDOW) == in_window, strength, 0.0)

    def _level(self, levels: mi.Int32, bonds: mi.Int32) -> mi.Int32:
        """Return the cell in z, lower: 0 straight, 1 over the bond, or what `_layers` says."""
        pad, turns = dr.minimum(levels, THROUGH_BOND), (levels + 1) // 2
        back = dr.select(turns <= TURNS, THROUGH_BOND + turns, DEPTHS)
        passed = dr.select((bonds & 1) == 1, IN_WINDOW + levels, back)
        return dr.select(bonds == 0, pad, passed)

    def _layers(self, image: mi.UInt32) -> _Layers:
        depth = -self._cell(image)[2]
        in_window, turns = depth >= IN_WINDOW, dr.maximum(depth - THROUGH_BOND, 0)
        levels = dr.select(in_window, depth - IN_WINDOW, 2 * turns - 1)
        through = turns > 0
        lower = dr.select(through, (levels + 1) // 2, 0)
        return _Layers(through, in_window, lower, dr.select(through, levels // 2, 0))

    def _window(self, layers: _Layers) -> mi.Float:
        """Return the mm of window, at right angles, before what `_ray` takes for a line."""
        return self.bond.thickness * mi.Float(
            layers.lower + layers.upper + dr.select(layers.in_window, 0, 1)
        )

    def reflected(
        self, image: mi.UInt32, a: mi.Point3f, direction: mi.Vector3f, *, chance: bool = False
    ) -> mi.Float:
        """Return the same as `LampImages.reflected`, with the bond."""
        bond, layers = self.bond, self._layers(image)
        through = layers.through
        x, y, z = self._cell(image)
        window_cos = dr.maximum(bond.window_cos(direction.z), 1e-6)
        # Where the way is in the window, per x and y of its direction.
        begin = a.z / dr.maximum(dr.abs(direction.z), 1e-6)
        end = begin + self._window(layers) / (window_cos * bond.ratio)
        passed = bond.passed(direction.z)
        lower = self._reflected_often(2, 0, layers.lower, window_cos, chance, bond.window)
        back = dr.select(layers.upper > 0, dr.power(1.0 - passed, mi.Float(layers.upper)), 1.0)
        both = dr.select(layers.in_window, passed, dr.square(passed))
        over_bond = dr.select(z < 0, 1.0 - passed, 1.0)
        found = dr.select(through, both * lower * back, over_bond)
        for axis, cell in enumerate((x, y)):
            first, last = (
                mi.Int32(
                    dr.floor((a[axis] + s * direction[axis] - self._low[axis]) / self._size[axis])
                )
                for s in (begin, end)
            )
            last = dr.select(layers.in_window, cell, last)
            for side in (0, 1):
                below = dr.select(through, met_until(last)[side] - met_until(first)[side], 0)
                above = met_until(cell)[side] - below
                cosine = direction[axis]
                found *= self._reflected_often(axis, side, above, cosine, chance)
                found *= self._reflected_often(
                    axis, side, below, cosine / bond.ratio, chance, bond.window
                )
        return found

    def _unfolding(self, image: mi.UInt32) -> tuple[mi.Vector3f, mi.Vector3f]:
        """Return sign and shift (mm) of images; the bond lies at z = 0."""
        sign, shift = super()._unfolding(image)
        return sign, mi.Vector3f(shift.x, shift.y, 0.0)

    def _line_to(
        self, image: mi.UInt32, a: mi.Point3f, point: mi.Point3f
    ) -> tuple[mi.Vector3f, mi.Float, mi.Vector3f]:
        """Return how the line to the image of a point begins, its length, and how it arrives."""
        straight, distance, folded = super()._line_to(image, a, point)
        layers = self._layers(image)
        through, inside = layers.through, layers.in_window
        sign, shift = self._unfolding(image)
        across = sign * mi.Vector3f(point) + shift - mi.Vector3f(a)
        # Up from the lower face or down from the bond.
        up = layers.lower > layers.upper
        last = dr.select(up, self.bond.thickness + point.z, -point.z)
        window = self._window(layers) + dr.select(inside, last, 0.0)
        way = way_through_bond(self.bond, across, a.z + dr.select(inside, 0.0, point.z), window)
        d = dr.select(inside, through_bond(way.direction, self.bond.ratio)[0], way.direction)
        bent = mi.Vector3f(sign.x * d.x, sign.y * d.y, dr.select(up, -d.z, d.z))
        return (
            dr.select(through, way.direction, straight),
            dr.select(through, way.pad_length + way.window_length, distance),
            dr.select(through, bent, folded),
        )

    def _ray(
        self, image: mi.UInt32, lamp: mi.UInt32, a: mi.Point3f, folded: mi.Vector3f
    ) -> LampRay:
        """Return what the line from ``a`` carries that arrives at the lamp along ``folded``."""
        sign, shift = self._unfolding(image)
        layers, bond = self._layers(image), self.bond
        through, inside, window = layers.through, layers.in_window, self._window(layers)
        cosine = dr.maximum(dr.abs(folded.z), 1e-6)
        pad_cos = dr.maximum(dr.select(inside, bond.pad_cos(cosine), cosine), 1e-6)
        window_cos = dr.maximum(dr.select(inside, cosine, bond.window_cos(cosine)), 1e-6)
        # Where its last part begins; unfolded, x and y go on along ``folded``.
        index = dr.select(inside, bond.ratio, 1.0)
        reach = index * a.z / pad_cos + index * window / (window_cos * bond.ratio)
        seen_from = sign * (mi.Vector3f(a) - shift)
        level = dr.select(inside & (layers.lower > layers.upper), -bond.thickness, 0.0)
        left = mi.Point3f(seen_from.x + reach * folded.x, seen_from.y + reach * folded.y, level)
        begin = dr.select(through, left, mi.Point3f(seen_from))

        def spread(distance: mi.Float) -> mi.Float:
            pad = a.z + dr.select(inside, 0.0, distance * cosine)
            bent = way_spread(
                bond, pad, window + dr.select(inside, distance * cosine, 0.0), pad_cos, window_cos
            )
            bent *= dr.select(inside, window_cos / pad_cos, 1.0)
            return dr.select(through, bent, dr.square(distance))

        ray = self.light.ray(lamp, begin, -folded, spread)
        # Radiance goes by the square of the index. Sums of light subpaths are kept per angle in the
        # window, as those of camera subpaths are.
        basic = dr.select(inside, dr.rcp(dr.square(bond.ratio)), 1.0)
        ray.radiance = [value * basic for value in ray.radiance]
        ray.emitted *= dr.select(inside, window_cos / pad_cos, 1.0)
        return ray

    def _left(self, image: mi.UInt32, folded: mi.Vector3f) -> mi.Vector3f:
        """Return how a line begins that arrives at the lamp along ``folded``."""
        direction, layers = super()._left(image, folded), self._layers(image)
        above, _ = through_bond(
            mi.Vector3f(direction.x, direction.y, dr.abs(direction.z)), self.bond.ratio
        )
        bent = dr.select(layers.in_window, above, direction)
        below = mi.Vector3f(bent.x, bent.y, -dr.abs(bent.z))
        return dr.select(layers.through, below, direction)

    def _met(
        self, image: mi.UInt32, way: FoldedWay, v: Vertex, d: mi.Vector3f
    ) -> tuple[mi.Bool, mi.Float, mi.Vector3f]:
        """Return whether light on its way to an image goes on at ``v``, how much, and where to."""
        there, reflected, turned = super()._met(image, way, v, d)
        bond, layers = self.mirrors.at_bond(v), self._layers(image)
        # Faces of the window that reflected before it leaves that: the lower one and the bond.
        leaves = (mi.Int32(way.levels) == layers.lower + layers.upper) & ~layers.in_window
        passes = layers.through & ((d.z < 0) | leaves)
        onward, passed = through_bond(d, self.bond.ratio)
        back = mi.Vector3f(d.x, d.y, -d.z)
        return (
            there | bond,
            dr.select(bond, dr.select(passes, passed, 1.0 - passed), reflected),
            dr.select(bond, dr.select(passes, onward, back), turned),
        )
