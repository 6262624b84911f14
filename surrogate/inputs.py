"""What the residual network sees of a cell: physical, continuous quantities of order one.

Everything is expressed in a mirrored frame in which the fiber stands at x <= 0, so that a fiber
and its mirror twin are one and the same case: the mirror symmetry of the sensor is exact, not
learned. An unseen fiber position, direction, bend or pad point inside the trained ranges is a new
value of these inputs, not a new case.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from render.bending import Array
from render.layout import flat_fiber_poses, flat_sites
from render.scene import Scene
from surrogate.basis import PARTNER, facet_harmonics, mirror_signs, turning
from surrogate.constants import store_constants
from surrogate.preview_grid import PreviewGrid

INPUT_NAMES = (
    "fiber x",
    "fiber y",
    "fiber at the tip",
    "cos phi",
    "sin phi",
    "cos 2 phi",
    "sin 2 phi",
    "bend",
    "site x",
    "site y",
    "log distance fiber-site",
    "cos of the angle at the fiber between its normal and the site",
    "sin of the angle at the fiber between its normal and the site",
    "cos of the angle at the fiber between beam and site",
    "sin of the angle at the fiber between beam and site",
    "log preview of the untouched pad",
    "first harmonic of the log preview, cosine",
    "first harmonic of the log preview, sine",
    "second harmonic of the log preview, cosine",
    "second harmonic of the log preview, sine",
)
BRIGHTNESS = INPUT_NAMES.index("log preview of the untouched pad")


class Inputs(nn.Module):
    """Inputs of the residual, ``(batch, fiber, bend, site, 20)``, in the order of INPUT_NAMES.

    Arguments of the constructor:
        scene: gives positions and directions (flat pad; the bend is an input of its own).
        grid: gives the scale and the offset of the log preview.
    """

    before: Tensor
    between: Tensor
    turn: Tensor
    ahead: Tensor
    aside: Tensor
    columns: Tensor
    partners: Tensor
    same: Tensor
    other: Tensor

    def __init__(self, scene: Scene, grid: PreviewGrid) -> None:
        """Precompute everything that depends on fiber and site alone, in float64."""
        super().__init__()
        sign = mirror_signs(scene)
        poses, sites = flat_fiber_poses(scene), flat_sites(scene)[:, :2]
        fiber = _mirrored(poses.position, sign)
        inward, along = _mirrored(poses.inward, sign), _mirrored(poses.along, sign)
        tip = np.abs(poses.along[:, 0]) > 0.5
        # phi runs the other way round for a mirrored tip fiber, whose "along" is x.
        turn = np.where(tip, sign, 1.0)
        along = along * turn[:, None]

        site = sites[None] * np.stack([sign, np.ones_like(sign)], axis=-1)[:, None]
        offset = site - fiber[:, None]
        distance = np.linalg.norm(offset, axis=-1)
        unit = offset / distance[..., None]
        ahead = np.einsum("fsc,fc->fs", unit, inward)
        aside = np.einsum("fsc,fc->fs", unit, along)
        half = np.array([scene.pad.width / 2, scene.pad.length / 2])
        count = len(sites)

        def per_cell(values: Array) -> Array:
            return np.repeat(values[:, None], count, axis=1)

        fixed = {
            "before": [
                per_cell(fiber[:, 0] / half[0]),
                per_cell(fiber[:, 1] / half[1]),
                per_cell(tip.astype(float)),
            ],
            "between": [
                site[..., 0] / half[0],
                site[..., 1] / half[1],
                np.log(distance / half[0]),
                ahead,
                aside,
            ],
        }
        flat = grid.log_transport[..., -1]
        self.center = float(flat.mean())
        self.scale = float(max(flat.std(), 1e-3))
        # Least-squares harmonics of the log preview over the facets; turned into the frame of the
        # fiber and the site by the inverse (the transpose) of what turns coefficients out of it.
        columns = np.linalg.pinv(facet_harmonics(scene)[:, :5])[1:].T
        same, other = (part[:, None, :, 1:5] for part in turning(scene))
        partner = PARTNER[1:5] - 1
        other = other[..., partner]
        self.bends = (float(grid.bends.min()), float(grid.bends.max()))
        constants = {
            "before": np.stack(fixed["before"], axis=-1),
            "between": np.stack(fixed["between"], axis=-1),
            "turn": turn,
            "ahead": ahead,
            "aside": aside,
            "columns": columns,
            "partners": columns[:, partner],
            "same": same,
            "other": other,
        }
        store_constants(self, constants)

    def forward(self, phi: Tensor, bend: Tensor, log_preview: Tensor) -> Tensor:
        """Return the inputs.

        Arguments:
            phi: ``(batch, fiber)`` rad.
            bend: ``(batch, bend)`` rad.
            log_preview: ``(batch, fiber, bend, site, facet + 1)``, the untouched pad last.
        """
        cells = log_preview[..., :1]
        zero = torch.zeros_like(cells)
        cos, sin = torch.cos(phi) * self.turn, torch.sin(phi)
        direction = torch.stack([cos, sin, cos * cos - sin * sin, 2 * cos * sin], dim=-1)
        # (batch, fiber, site): the beam is cos along + sin inward in the plane of the pad.
        along = cos[..., None] * self.aside + sin[..., None] * self.ahead
        across = cos[..., None] * self.ahead - sin[..., None] * self.aside
        beam = torch.stack([along, across], dim=-1)
        low, high = self.bends
        level = (2 * bend - low - high) / max(high - low, 1e-9) if high > low else 0 * bend
        brightness = (log_preview[..., -1:] - self.center) / self.scale
        shape = torch.matmul(log_preview, self.columns) * self.same
        shape = shape + torch.matmul(log_preview, self.partners) * self.other
        return torch.cat(
            [
                zero + self.before[None, :, None],
                zero + direction[:, :, None, None],
                zero + level[:, None, :, None, None],
                zero + self.between[None, :, None],
                zero + beam[:, :, None],
                brightness,
                shape,
            ],
            dim=-1,
        )


def _mirrored(vectors: Array, sign: Array) -> Array:
    """Return the pad-plane part ``(fiber, 2)`` of ``vectors`` with x times ``sign``."""
    return vectors[:, :2] * np.stack([sign, np.ones_like(sign)], axis=-1)
