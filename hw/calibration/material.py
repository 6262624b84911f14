"""What calibration looks for: the material of the rig, and a scene that has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw.errors import CalibrationError
from render.arrays import Array
from render.scene.schema import Scene

NAMES = ("reduced_scattering", "absorption", "sigma_v", "roughness")
UNITS = ("1/mm", "1/mm", "deg", "")
LOW = np.array([0.55, 0.0, np.radians(9.0), 0.03])
HIGH = np.array([1.8, 0.06, np.radians(22.0), 0.25])
"""Where materials are looked for: reduced scattering and absorption in 1/mm, sigma_v in rad,
Beckmann alpha. Silicones filled for diffusion lie between 0.5 and 2 /mm."""


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
