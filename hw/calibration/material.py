"""What calibration looks for: the material of the rig, a scene that has it, and its range.

Over the range, log light is a polynomial of the second degree in unit coordinates: -1 to 1 between
`LOW` and `HIGH`, of scattering's logarithm.
"""

from __future__ import annotations

import itertools
from dataclasses import astuple, dataclass

import numpy as np

from hw.errors import CalibrationError
from render.arrays import Array
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
DEGREE = 2
EXPONENTS = np.array(
    [e for e in itertools.product(range(DEGREE + 1), repeat=4) if sum(e) <= DEGREE]
)
"""Exponents ``(term, 4)`` of the polynomial's terms."""


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
                "choose a scene with one",
                field="diffuser",
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
    materials = np.asarray(qmc.scale(unit, *_logged(np.stack([LOW, HIGH]))))
    materials[:, 0] = np.exp(materials[:, 0])
    return materials


def terms(materials: Array) -> Array:
    """Return the polynomial's terms ``(..., term)`` of materials ``(..., 4)``."""
    return np.asarray(np.prod(_to_unit(materials)[..., None, :] ** EXPONENTS, axis=-1))


def terms_slope(material: Array) -> Array:
    """Return the terms' derivatives ``(4, term)`` by the values of one material ``(4,)``."""
    scale = 2 / (HIGH - LOW)
    scale[0] = 2 / np.log(HIGH[0] / LOW[0]) / material[0]
    # (4, term, 4)
    lower = np.maximum(EXPONENTS - np.eye(4, dtype=int)[:, None], 0)
    return np.asarray(scale[:, None] * EXPONENTS.T * np.prod(_to_unit(material) ** lower, axis=-1))


def _to_unit(materials: Array) -> Array:
    """Return unit coordinates ``(..., 4)``."""
    low, high = _logged(np.stack([LOW, HIGH]))
    return np.asarray(2 * (_logged(materials) - low) / (high - low) - 1)


def _logged(materials: Array) -> Array:
    """Return materials ``(..., 4)`` with the logarithm of their scattering."""
    return np.concatenate([np.log(materials[..., :1]), materials[..., 1:]], axis=-1)
