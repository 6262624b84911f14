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

from render.arrays import Array
from render.geometry import flat_sites
from render.scene import Scene
from surrogate.model.facet_basis import (
    PARTNER,
    facet_harmonics,
    mirror_signs,
    store_constants,
    turning,
)
from surrogate.model.lamp_copies import copied_poses
from surrogate.model.preview_grid import PreviewGrid

FEATURE_NAMES = (
    "fiber x",
    "fiber y",
    "fiber at the tip",
    "site x",
    "site y",
    "log distance fiber-site",
    "cos of the angle at the fiber between its normal and the site",
    "sin of the angle at the fiber between its normal and the site",
    "cos phi",
    "sin phi",
    "cos 2 phi",
    "sin 2 phi",
    "cos of the angle at the fiber between beam and site",
    "sin of the angle at the fiber between beam and site",
    "bend",
    "log preview of the untouched pad",
    "first harmonic of the log preview, cosine",
    "first harmonic of the log preview, sine",
    "second harmonic of the log preview, cosine",
    "second harmonic of the log preview, sine",
)
BEND = FEATURE_NAMES.index("bend")
BRIGHTNESS = FEATURE_NAMES.index("log preview of the untouched pad")


def feature_names(scene: Scene) -> tuple[str, ...]:
    """Return the names of the inputs of a scene's cells, without those of a free material.

    Named states have no order: instead of the bend there is one input for every state but the
    rest, 1 in that state and 0 in all others. The first takes the place of the bend, the others
    are the last.
    """
    if scene.states is None:
        return FEATURE_NAMES
    first, *others = (f"in state {name}" for name in scene.state_names[1:])
    return (*FEATURE_NAMES[:BEND], first, *FEATURE_NAMES[BEND + 1 :], *others)


class CellFeatures(nn.Module):
    """Inputs of the residual, ``(20, batch, fiber, bend, site)``, in the order of `feature_names`.

    A free material adds its quantities, in [-1, 1], at the end.

    Arguments of the constructor:
        scene: gives positions and directions (flat pad; the bend is an input of its own).
        grid: gives the scale and the offset of the log preview.
    """

    fixed: Tensor
    turn: Tensor
    turns: Tensor
    angles: Tensor
    columns: Tensor
    turned: Tensor

    def __init__(self, scene: Scene, grid: PreviewGrid) -> None:
        """Precompute everything that depends on fiber and site alone, in float64."""
        super().__init__()
        sign = mirror_signs(scene)
        poses, sites = copied_poses(scene), flat_sites(scene)[:, :2]
        fiber = _mirrored(poses.position, sign)
        inward, along = _mirrored(poses.inward, sign), _mirrored(poses.along, sign)
        tip = np.abs(poses.along[:, 0]) > 0.5
        # phi runs the other way round for a mirrored tip fiber, whose "along" is x.
        turn = np.where(tip, sign, 1.0)
        along = along * turn[:, None]
        # Of a lamp that does not turn, phi says nothing: it counts as pi/2.
        self.fixed_lamps = not poses.turns.all()

        site = sites[None] * np.stack([sign, np.ones_like(sign)], axis=-1)[:, None]
        offset = site - fiber[:, None]
        distance = np.linalg.norm(offset, axis=-1)
        unit = offset / distance[..., None]
        ahead = np.einsum("fsc,fc->fs", unit, inward)
        aside = np.einsum("fsc,fc->fs", unit, along)
        half = np.array([scene.pad.width / 2, scene.pad.length / 2])
        columns = [fiber[:, :1] / half[0], fiber[:, 1:] / half[1], tip.astype(float)[:, None]]
        columns += [site[..., 0] / half[0], site[..., 1] / half[1]]
        columns += [np.log(distance / half[0]), ahead, aside]
        fixed = np.stack([np.broadcast_to(column, distance.shape) for column in columns])
        flat = grid.log_transport[..., -1]
        self.center = float(flat.mean())
        self.scale = float(max(flat.std(), 1e-3))
        # Least-squares harmonics of the log preview over the facets; turned into the frame of the
        # fiber and the site by the inverse (the transpose) of what turns coefficients out of it.
        harmonics = np.linalg.pinv(facet_harmonics(scene)[:, :5])[1:]
        same, other = (np.moveaxis(part[..., 1:5], -1, 0) for part in turning(scene))
        partner = PARTNER[1:5] - 1
        self.bends = (float(grid.bends.min()), float(grid.bends.max()))
        self.states = 0 if scene.states is None else len(scene.states)
        constants = {
            "fixed": fixed[:, None, :, None],
            "turn": turn * poses.turns,
            "angles": _angles(ahead, aside),
            "columns": np.concatenate([harmonics, harmonics[partner]]),
            "turned": np.concatenate([same, other[partner]])[:, None, :, None],
        }
        if self.fixed_lamps:
            constants["turns"] = poses.turns
        store_constants(self, constants)

    def forward(
        self, phi: Tensor, bend: Tensor, log_preview: Tensor, material: Tensor | None = None
    ) -> Tensor:
        """Return the inputs.

        Arguments:
            phi: ``(batch, fiber)`` rad.
            bend: ``(batch, bend)`` rad, or numbers of named states.
            log_preview: ``(normal, batch, fiber, bend, site)``, the untouched pad last.
            material: ``(batch, quantity)`` in [-1, 1], where it is free.
        """
        flat = log_preview[-1:]
        zero = 0.0 * flat
        cos, sin = torch.cos(phi) * self.turn, torch.sin(phi)
        if self.fixed_lamps:
            sin = 1.0 + self.turns * (sin - 1.0)
        waves = torch.stack([cos, sin, cos * cos - sin * sin, 2 * cos * sin], dim=-1)
        # (fiber, batch, 4) x (fiber, 4, 6 site) -> (6, batch, fiber, 1, site)
        angles = torch.matmul(waves.transpose(0, 1), self.angles)
        angles = angles.reshape(angles.shape[0], angles.shape[1], 6, -1).permute(2, 1, 0, 3)
        level, *others = self._levels(bend)
        shape = torch.matmul(self.columns, log_preview.reshape(log_preview.shape[0], -1))
        shape = shape.reshape(-1, *log_preview.shape[1:]) * self.turned
        parts = [
            zero + self.fixed,
            zero + angles[:, :, :, None],
            zero + level[None, :, None, :, None],
            (flat - self.center) / self.scale,
            shape[:4] + shape[4:],
            *(zero + other[None, :, None, :, None] for other in others),
        ]
        if material is not None:
            parts.append(zero + material.t()[:, :, None, None, None])
        return torch.cat(parts)

    def _levels(self, bend: Tensor) -> list[Tensor]:
        """Return what ``bend`` ``(batch, bend)`` is to the residual, one input of its shape each.

        That is the bend in [-1, 1], or which of the named states but the rest it is.
        """
        if self.states:
            return [torch.relu(1.0 - torch.abs(bend - k)) for k in range(1, 1 + self.states)]
        low, high = self.bends
        return [(2 * bend - low - high) / max(high - low, 1e-9) if high > low else 0 * bend]


def _angles(ahead: Array, aside: Array) -> Array:
    """Return what makes the six inputs with phi of ``cos, sin, cos 2, sin 2``: ``(fiber, 4, 6 s)``.

    The first four are themselves; the beam ``cos along + sin inward`` in the plane of the pad has
    the cosine ``cos aside + sin ahead`` and the sine ``cos ahead - sin aside`` to the site.
    """
    fibers, sites = ahead.shape
    out = np.zeros((fibers, 4, 6, sites))
    for wave in range(4):
        out[:, wave, wave] = 1.0
    out[:, 0, 4], out[:, 1, 4] = aside, ahead
    out[:, 0, 5], out[:, 1, 5] = ahead, -aside
    return out.reshape(fibers, 4, 6 * sites)


def _mirrored(vectors: Array, sign: Array) -> Array:
    """Return the pad-plane part ``(fiber, 2)`` of ``vectors`` with x times ``sign``."""
    return vectors[:, :2] * np.stack([sign, np.ones_like(sign)], axis=-1)
