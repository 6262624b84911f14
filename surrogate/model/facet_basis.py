"""The basis in the facet normal that the residual is expanded in.

A facet with unit normal ``n`` (site frame: x across, y to the tip, z to the coating) has the
reduced normal ``w = (n_x + i n_y) / sin(slope)``, where ``slope`` is the slope of the scene's
indenter: facets lie on the unit circle, the untouched pad at 0. The basis has two parts:

- harmonics ``1, Re w^k, Im w^k (k = 1..3), |w|^2`` of eq. (4.2) in the azimuth, with the powers
  of the slope that keep them smooth at the untouched pad;
- contrast terms ``q, q^2`` with ``q = tanh((log P - log P_0) / 2)``: P is the preview of the
  facet and P_0 that of the untouched pad. They let the residual raise or deepen what the preview
  holds to be shadow, which harmonics describe badly at the terminator.

Every normal inside the cone is therefore an interpolation between the trained ones. Coefficients
are learned in the frame whose first axis points from the fiber to the site, mirrored for fibers at
x > 0: seen from there, every site looks alike.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn

from render.arrays import Array
from render.geometry import camera_is_symmetric, facet_normals, flat_sites, states_are_symmetric
from render.scene import Scene
from surrogate.model.lamp_copies import copied_poses

ORDERS = np.array([0, 1, 1, 2, 2, 3, 3, 0])
"""How many times faster than the frame each harmonic turns; pairs are (Re, Im)."""
PARTNER = np.array([0, 2, 1, 4, 3, 6, 5, 7])
"""The other half of each pair."""
ODD = np.array([False, False, True, False, True, False, True, False])
"""The harmonics that change sign under a mirror that contains the frame's first axis."""
HARMONICS = len(ORDERS)
SIZE = HARMONICS + 2


def harmonics(normals: Array, slope: float) -> Array:
    """Return the harmonics ``(..., 8)`` of unit normals ``(..., 3)``; float64, no unit."""
    w = (normals[..., 0] + 1j * normals[..., 1]) / np.sin(slope)
    powers = [part for k in (1, 2, 3) for part in ((w**k).real, (w**k).imag)]
    return np.stack([np.ones_like(w.real), *powers, np.abs(w) ** 2], axis=-1)


def facet_harmonics(scene: Scene) -> Array:
    """Return the harmonics ``(facet + 1, 8)`` of the scene's facets, then of the untouched pad."""
    normals = np.concatenate([facet_normals(scene), [[0.0, 0.0, -1.0]]])
    return harmonics(normals, scene.indenter.slope)


def mirror_signs(scene: Scene) -> Array:
    """Return -1 for the fibers that stand at x > 0 and are seen in the mirror, else 1.

    All are 1 where the camera stands or looks askew, or a state moves the skin to one side: the
    light that it sees has no mirror image.
    """
    mirrored = copied_poses(scene).position[:, 0] > 1e-9
    symmetric = camera_is_symmetric(scene) and states_are_symmetric(scene)
    return np.where(mirrored & symmetric, -1.0, 1.0)


def turning(scene: Scene) -> tuple[Array, Array]:
    """Return ``(same, other)``, ``(fiber, site, 8)``, that turn coefficients to the site's frame.

    ``site = same * local + other * local[PARTNER]``. With the angle psi of the direction from
    fiber to site, ``a' - i b' = (a -+ i b) exp(-i k psi)``, plus for mirrored fibers.
    """
    offset = flat_sites(scene)[None, :, :2] - copied_poses(scene).position[:, None, :2]
    psi = np.arctan2(offset[..., 1], offset[..., 0])[..., None] * ORDERS
    # A mirrored fiber's odd coefficients change sign before they are turned.
    sign = np.where(ODD, mirror_signs(scene)[:, None], 1.0)[:, None, :]
    side = np.where(ORDERS == 0, 0.0, np.where(ODD, 1.0, -1.0))
    return np.cos(psi) * sign, np.sin(psi) * side * sign[..., PARTNER]


class Expansion(nn.Module):
    """From coefficients to residuals, both ``(member, output or normal, ..., fiber, bend, site)``.

    Cells come last: runtimes broadcast over long runs of memory much faster than over short ones.
    """

    harmonics: Tensor
    same: Tensor
    other: Tensor
    partner: Tensor

    def __init__(self, scene: Scene) -> None:
        """Store the harmonics and the turns as float32 constants."""
        super().__init__()
        same, other = (np.moveaxis(part, -1, 0)[:, None, :, None] for part in turning(scene))
        store_constants(self, {"harmonics": facet_harmonics(scene), "same": same, "other": other})
        self.register_buffer("partner", torch.as_tensor(PARTNER))

    def forward(self, coefficients: Tensor, log_preview: Tensor) -> Tensor:
        """Return the residual in log T ``(member, normal, batch, fiber, bend, site)``.

        Arguments:
            coefficients: ``(member, 10, batch, fiber, bend, site)``.
            log_preview: ``(normal, batch, fiber, bend, site)``, the untouched pad last.
        """
        local = coefficients[:, :HARMONICS]
        turned = local * self.same + local.index_select(1, self.partner) * self.other
        cells = turned.reshape(turned.shape[0], HARMONICS, -1)
        smooth = torch.matmul(self.harmonics, cells)
        smooth = smooth.reshape(turned.shape[0], -1, *log_preview.shape[1:])
        q = contrast(log_preview)
        first = coefficients[:, HARMONICS : HARMONICS + 1]
        second = coefficients[:, HARMONICS + 1 :]
        return smooth + (first + second * q) * q


def contrast(log_preview: Tensor) -> Tensor:
    """Return ``tanh((log P - log P_0) / 2)``, within (-1, 1), 0 for the untouched pad.

    ``log_preview`` is ``(normal, ...)``, the untouched pad last.
    """
    return torch.tanh(0.5 * (log_preview - log_preview[-1:]))


def store_constants(module: nn.Module, arrays: Mapping[str, Array]) -> None:
    """Register ``arrays``, computed in float64, as float32 buffers of ``module``."""
    for name, values in arrays.items():
        module.register_buffer(name, torch.as_tensor(values, dtype=torch.float32))
