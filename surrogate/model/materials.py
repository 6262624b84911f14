"""The free material of a scene: its range, its samples, and the polynomials that follow it.

A material is an array ``(..., quantity)`` in the order of ``MaterialRange.names`` and in their
units (1/mm, mm). In between they are mapped to [-1, 1] over the range, reduced scattering by its
logarithm: behind some mean free paths light depends on it by powers.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.scene import Scene, unchecked

LOGARITHMIC = ("reduced_scattering",)
DEGREE = 2


@dataclass(frozen=True, eq=False)
class MaterialRange:
    """The range of the free quantities, ``(quantity,)`` arrays float64.

    Arguments:
        names: as in the scene's section ``free``.
        low, high: ends of the range; nominal: the scene's own values.
    """

    names: tuple[str, ...]
    low: Array
    high: Array
    nominal: Array

    @classmethod
    def of(cls, scene: Scene) -> MaterialRange | None:
        """Return the range that ``scene`` leaves free; None where it leaves nothing."""
        if scene.free is None or scene.diffuser is None:
            return None
        ranges, values = scene.free.ranges(), scene.diffuser.free_values
        ends = np.array(list(ranges.values()), dtype=np.float64)
        nominal = np.array([values[name] for name in ranges])
        return cls(tuple(ranges), ends[:, 0], ends[:, 1], nominal)

    @property
    def logarithmic(self) -> np.ndarray:
        """True for the quantities that are mapped by their logarithm."""
        return np.array([name in LOGARITHMIC for name in self.names])

    def unit(self, materials: Array) -> Array:
        """Return ``materials`` ``(..., quantity)`` mapped to [-1, 1] over the range."""
        value, low, high = (self._mapped(x) for x in (materials, self.low, self.high))
        return np.asarray(2.0 * (value - low) / (high - low) - 1.0)

    def from_unit(self, unit: Array) -> Array:
        """Return the materials of ``unit`` ``(..., quantity)``, the inverse of :meth:`unit`."""
        low, high = self._mapped(self.low), self._mapped(self.high)
        value = low + 0.5 * (unit + 1.0) * (high - low)
        return np.asarray(np.where(self.logarithmic, np.exp(value), value))

    def _mapped(self, x: Array) -> Array:
        return np.where(self.logarithmic, np.log(np.where(self.logarithmic, x, 1.0)), x)

    @property
    def exponents(self) -> np.ndarray:
        """Exponents ``(term, quantity)`` of the polynomial's terms, without the constant."""
        powers = itertools.product(range(DEGREE + 1), repeat=len(self.names))
        return np.array([p for p in powers if 0 < sum(p) <= DEGREE])

    def terms(self, materials: Array) -> Array:
        """Return the terms ``(..., term)``, all 0 at the scene's own material."""
        return _powers(self.unit(materials), self.exponents) - self.nominal_terms

    @property
    def nominal_terms(self) -> Array:
        """The terms' plain powers at the scene's own material, ``(term,)``."""
        return _powers(self.unit(self.nominal), self.exponents)

    def samples(self, count: int) -> Array:
        """Return ``count`` materials, the scene's own first, the others filling the range (Sobol).

        The others sit at the ends too: Sobol points are stretched to reach them.
        """
        from scipy.stats import qmc

        drawn = qmc.Sobol(len(self.names), scramble=True, rng=np.random.default_rng(1))
        points = drawn.random_base2(int(np.ceil(np.log2(max(count - 1, 2)))))[: count - 1]
        low, high = points.min(axis=0), points.max(axis=0)
        unit = 2.0 * (points - low) / np.maximum(high - low, 1e-12) - 1.0
        return np.concatenate([self.nominal[None], self.from_unit(unit)])

    def scene_with(self, scene: Scene, material: Array) -> Scene:
        """Return ``scene`` made of ``material`` ``(quantity,)``, with nothing left free."""
        layer = scene.diffuser
        assert layer is not None  # a range comes from a scene with a diffuser
        if not np.array_equal(material, self.nominal):
            for name, value in zip(self.names, material, strict=True):
                layer = layer.with_free(name, float(value))
        return unchecked(scene, {"diffuser": layer, "free": None})


def _powers(unit: Array, exponents: np.ndarray) -> Array:
    return np.asarray(np.prod(unit[..., None, :] ** exponents, axis=-1))
