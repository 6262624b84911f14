"""What calibration looks for: the material of the rig, a scene that has it, and its range.

Over the range, log light is a polynomial of the second degree in unit coordinates: -1 to 1 between
`LOW` and `HIGH`, of scattering's logarithm (`surrogate.model.materials.MaterialRange`).
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from hw.errors import CalibrationError
from render.arrays import Array
from surrogate.model.materials import MaterialRange
from tactilux import Scene

NAMES = ("reduced_scattering", "absorption", "sigma_v", "roughness")
TITLES = ("reduced scattering", "absorption", "beam width sigma_v", "roughness alpha")
UNITS = ("1/mm", "1/mm", "deg", "")
PER_UNIT = np.array([1.0, 1.0, 180 / np.pi, 1.0])
"""What values are multiplied with to be told in `UNITS`."""
LOW = np.array([0.55, 0.0, np.radians(9.0), 0.03])
HIGH = np.array([1.8, 0.06, np.radians(22.0), 0.25])
"""Where materials are looked for: reduced scattering and absorption in 1/mm, sigma_v in rad,
Beckmann alpha. Silicones filled for diffusion lie between 0.5 and 2 /mm."""
RANGE = MaterialRange(NAMES, LOW, HIGH, nominal=LOW)
EXPONENTS = np.concatenate([np.zeros((1, 4), dtype=np.int64), RANGE.exponents])
"""Exponents ``(term, 4)`` of the polynomial's terms, the constant first."""


@dataclass(frozen=True)
class Material:
    """Reduced scattering sigma_s (1 - g) and absorption in 1/mm, sigma_v in rad, Beckmann alpha.

    The anisotropy g stays what the scene says: behind some reduced mean free paths, light with the
    same sigma_s (1 - g) is the same light, so photographs cannot tell g and sigma_s apart.
    """

    reduced_scattering: float
    absorption: float
    sigma_v: float
    roughness: float

    @classmethod
    def of(cls, scene: Scene) -> Material:
        """Return the material of a scene with a diffuser.

        Raises:
            CalibrationError: there is no diffuser.
        """
        layer = scene.diffuser
        if layer is None:
            raise CalibrationError(
                f"scene {scene.name} has no diffuser, so there is no scattering to calibrate: "
                "choose a scene with one; `tactilux hw set`, `capture`, `demo --no-calibrate` and "
                "`tactilux check` do without",
                field="diffuser",
            )
        if scene.fibers is None or scene.lamps:
            raise CalibrationError(
                f"scene {scene.name} has lamps in rows or lists of their own, calibration knows "
                "fibers of one sigma_v: choose a scene with [fibers] alone",
                field="rows",
            )
        scattering = layer.sigma_s * (1 - layer.g)
        return cls(scattering, layer.sigma_a, scene.fibers.sigma_v, scene.pad.roughness)

    @classmethod
    def from_array(cls, values: Array) -> Material:
        """Return the material of ``(4,)`` numbers in the order of `NAMES`."""
        return cls(*(float(value) for value in values))

    def array(self) -> Array:
        """Return ``(4,)`` numbers in the order of `NAMES`."""
        return np.array(astuple(self))

    def put_into(self, scene: Scene) -> Scene:
        """Return ``scene`` with this material; its g is kept."""
        layer = scene.diffuser
        assert layer is not None
        assert scene.fibers is not None
        sigma_s = self.reduced_scattering / (1 - layer.g)
        return scene.model_copy(
            update={
                "diffuser": layer.model_copy(
                    update={"sigma_s": sigma_s, "sigma_a": self.absorption}
                ),
                "fibers": scene.fibers.model_copy(update={"sigma_v": self.sigma_v}),
                "pad": scene.pad.model_copy(update={"roughness": self.roughness}),
            }
        )


def sobol_materials(count: int) -> Array:
    """Return ``count`` materials ``(material, 4)`` that fill the range, scattering by its log."""
    from scipy.stats import qmc

    sampler = qmc.Sobol(4, scramble=True, rng=np.random.default_rng(1))
    unit = sampler.random_base2(int(np.ceil(np.log2(count))))[:count]
    return RANGE.from_unit(2 * unit - 1)


def terms(materials: Array) -> Array:
    """Return the polynomial's terms ``(..., term)`` of materials ``(..., 4)``."""
    return np.asarray(np.prod(RANGE.unit(materials)[..., None, :] ** EXPONENTS, axis=-1))


def terms_slope(material: Array) -> Array:
    """Return the terms' derivatives ``(4, term)`` by the values of one material ``(4,)``."""
    scale = 2 / (HIGH - LOW)
    scale[0] = 2 / np.log(HIGH[0] / LOW[0]) / material[0]
    # (4, term, 4)
    lower = np.maximum(EXPONENTS - np.eye(4, dtype=int)[:, None], 0)
    powers = np.prod(RANGE.unit(material) ** lower, axis=-1)
    return np.asarray(scale[:, None] * EXPONENTS.T * powers)
