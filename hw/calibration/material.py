"""What calibration looks for: the material of the rig, a scene that has it, and its range.

Over the range, log light is a polynomial of the second degree in unit coordinates: -1 to 1 between
`LOW` and `HIGH`, of scattering's logarithm.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from dataclasses import dataclass

import numpy as np

from hw.errors import CalibrationError
from render.arrays import Array
from tactilux import Scene

NAMES = ("reduced_scattering", "absorption", "sigma_v", "roughness")
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
        return cls(
            layer.sigma_s * (1 - layer.g),
            layer.sigma_a,
            scene.fibers.sigma_v,
            scene.pad.roughness,
        )

    @classmethod
    def from_array(cls, values: Array) -> Material:
        """Return the material of ``(4,)`` numbers in the order of `NAMES`."""
        return cls(*(float(value) for value in values))

    def array(self) -> Array:
        """Return ``(4,)`` numbers in the order of `NAMES`."""
        return np.array([self.reduced_scattering, self.absorption, self.sigma_v, self.roughness])

    def put_into(self, scene: Scene) -> Scene:
        """Return ``scene`` with this material; its g is kept."""
        assert scene.diffuser is not None
        layer = scene.diffuser.model_copy(
            update={
                "sigma_s": self.reduced_scattering / (1 - scene.diffuser.g),
                "sigma_a": self.absorption,
            }
        )
        return scene.model_copy(
            update={
                "diffuser": layer,
                "fibers": scene.fibers.model_copy(update={"sigma_v": self.sigma_v}),
                "pad": scene.pad.model_copy(update={"roughness": self.roughness}),
            }
        )


def design_key(version: int, scene: Scene, phi: Array, bends: Array, *details: object) -> str:
    """Return a hash of what all rigs of a design share, at any material, and of ``details``."""
    neutral = Material.from_array(np.sqrt(LOW * HIGH) + 0.01).put_into(scene)
    content = [version, neutral.hash, np.round(phi, 9).tolist(), np.round(bends, 9).tolist(),
               *details]  # fmt: skip
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


def sobol_materials(count: int) -> Array:
    """Return ``count`` materials ``(material, 4)`` that fill the range, scattering by its log."""
    from scipy.stats import qmc

    unit = qmc.Sobol(4, scramble=True, rng=np.random.default_rng(1)).random_base2(
        int(np.ceil(np.log2(count)))
    )[:count]
    low, high = LOW.copy(), HIGH.copy()
    low[0], high[0] = np.log(low[0]), np.log(high[0])
    materials = low + unit * (high - low)
    materials[:, 0] = np.exp(materials[:, 0])
    return np.asarray(materials)


def terms(materials: Array) -> Array:
    """Return the polynomial's terms ``(material, term)`` of ``(material, 4)``."""
    unit = _to_unit(materials)
    return np.asarray(np.prod(unit[:, None, :] ** EXPONENTS[None], axis=-1))


def terms_slope(material: Array) -> Array:
    """Return the terms' derivatives ``(4, term)`` by the values of one material ``(4,)``."""
    unit = _to_unit(material[None])[0]
    scale = 2 / (HIGH - LOW)
    scale[0] = 2 / np.log(HIGH[0] / LOW[0]) / material[0]
    rows = []
    for index in range(4):
        lower = EXPONENTS.copy()
        lower[:, index] = np.maximum(lower[:, index] - 1, 0)
        rows.append(scale[index] * EXPONENTS[:, index] * np.prod(unit**lower, axis=1))
    return np.stack(rows)


def _to_unit(materials: Array) -> Array:
    scaled = [np.log(materials[:, 0]), *materials.T[1:]]
    ends = np.stack([LOW, HIGH])
    ends[:, 0] = np.log(ends[:, 0])
    return np.stack(
        [2 * (x - low) / (high - low) - 1 for x, low, high in zip(scaled, *ends, strict=True)],
        axis=-1,
    )
