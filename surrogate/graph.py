"""The whole checker as one torch module: preview, residual, superposition, exposure and metric.

This is what is exported to ``checker.onnx`` and what training predicts with, so the two cannot
drift apart.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from render.bending import Array
from render.metric import design_score, image_counts, site_metric
from render.scene import Scene
from surrogate.basis import Expansion
from surrogate.constants import store_constants
from surrogate.inputs import BRIGHTNESS, Inputs
from surrogate.preview_grid import PreviewGrid


class Prediction(NamedTuple):
    """Outputs of the checker, named and shaped as in the ONNX contract."""

    counts: Tensor
    counts_spread: Tensor
    background: Tensor
    metric: Tensor
    score: Tensor
    domain_excess: Tensor


class PreviewTable(nn.Module):
    """The interpolated log preview: ``(batch, fiber, bend, site, facet + 1)``."""

    table: Tensor

    def __init__(self, grid: PreviewGrid) -> None:
        """Store the values of ``grid`` at its nodes as float32 constants."""
        super().__init__()
        table = grid.log_transport
        self.shape = table.shape
        flat = table.reshape(table.shape[0], table.shape[1], -1)
        store_constants(self, {"table": flat})
        self.in_phi, self.in_bend = Lagrange(grid.phi), Lagrange(grid.bends)

    def forward(self, phi: Tensor, bend: Tensor) -> Tensor:
        """Return the log preview for ``phi`` ``(batch, fiber)``, ``bend`` ``(batch, bend)``."""
        fibers, _, nodes, sites, normals = self.shape
        # (fiber, batch, phi node) x (fiber, phi node, rest), then (bend, node) x (node, rest).
        at_phi = torch.matmul(self.in_phi(phi).transpose(0, 1), self.table).transpose(0, 1)
        at_phi = at_phi.reshape(-1, fibers, nodes, sites * normals)
        out = torch.matmul(self.in_bend(bend)[:, None], at_phi)
        return out.reshape(out.shape[0], fibers, out.shape[2], sites, normals)


class Lagrange(nn.Module):
    """Weights ``(..., node)`` that interpolate values at Chebyshev nodes to ``x`` ``(...)``.

    ``l_j(x) = prod_{i != j} (x - x_i) / (x_j - x_i)``: the polynomial of
    :func:`render.chebyshev.interpolation_weights` without its division by ``x - x_j``, so that
    float32 values and derivatives are right at the nodes too.
    """

    nodes: Tensor
    slope: Tensor
    diagonal: Tensor

    def __init__(self, nodes: Array) -> None:
        """Precompute the reciprocal gaps in float64."""
        super().__init__()
        gaps = nodes[:, None] - nodes[None, :] + np.eye(len(nodes))
        diagonal = np.eye(len(nodes))
        slope = (1.0 - diagonal) / gaps
        store_constants(self, {"nodes": nodes, "slope": slope, "diagonal": diagonal})

    def forward(self, x: Tensor) -> Tensor:
        """Return the weights."""
        factors = (x[..., None] - self.nodes)[..., None, :] * self.slope + self.diagonal
        return torch.prod(factors, dim=-1)


class Checker(nn.Module):
    """From a lighting design to the colours it must produce, with their uncertainty.

    Arguments of the constructor:
        scene: the sensor.
        grid: its preview.
        residual: model of log(T_reference / T_preview), see ``networks``.
        exposure: counts per unit of radiance; lam: weight of M_phi in eq. (4.6).
        spread: ``(b0, b1)``: log of the standard deviation of one cell's residual is
            ``b0 + b1 z``, with z the standardised log preview of the untouched pad.
    """

    def __init__(
        self,
        scene: Scene,
        grid: PreviewGrid,
        residual: nn.Module,
        *,
        exposure: float,
        lam: float,
        spread: tuple[float, float],
    ) -> None:
        """Assemble the parts."""
        super().__init__()
        self.preview, self.inputs = PreviewTable(grid), Inputs(scene, grid)
        self.residual, self.expansion = residual, Expansion(scene)
        self.exposure, self.lam, self.spread = exposure, lam, spread
        self.bends = (float(grid.bends.min()), float(grid.bends.max()))

    def forward(self, phi: Tensor, power: Tensor, bend: Tensor) -> Prediction:
        """Return the prediction.

        Arguments:
            phi: ``(batch, fiber)`` rad.
            power: ``(batch, fiber, 3)`` in [0, 1].
            bend: ``(batch, bend)`` rad.

        Inputs outside their range are moved to its edge and reported in ``domain_excess``;
        inputs that are not finite give NaN.
        """
        low, high = self.bends
        inside = (
            _within(phi, 0.0, math.pi),
            _within(power, 0.0, 1.0),
            _within(bend, low, high),
        )
        log_preview, residual, spread = self.transport(inside[0], inside[2])
        shared = residual.sum(dim=0) / residual.shape[0]
        transport = torch.exp(log_preview + shared)
        counts = image_counts(transport, inside[1], self.exposure)
        facets = counts[..., :-1, :]
        metric = site_metric(facets, self.lam)
        return Prediction(
            counts=facets,
            counts_spread=self.counts_spread(transport, residual - shared, spread, inside[1]),
            background=counts[..., -1, :],
            metric=metric,
            score=design_score(metric).score,
            domain_excess=torch.maximum(
                torch.maximum(
                    _excess(phi, 0.0, math.pi).amax(dim=1),
                    _excess(power, 0.0, 1.0).amax(dim=(1, 2)),
                ),
                _excess(bend, low, high).amax(dim=1),
            ),
        )

    def transport(self, phi: Tensor, bend: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return log preview, residual of every member and standard deviation of the residual.

        Shapes ``(batch, fiber, bend, site, facet + 1)``, the same with ``member`` in front, and
        ``(batch, fiber, bend, site, 1)``; the untouched pad is the last normal.
        """
        log_preview = self.preview(phi, bend)
        x = self.inputs(phi, bend, log_preview)
        residual = self.expansion(self.residual(x), log_preview)
        brightness = x[..., BRIGHTNESS : BRIGHTNESS + 1]
        spread = torch.exp(self.spread[0] + self.spread[1] * brightness)
        return log_preview, residual, spread

    def counts_spread(
        self, transport: Tensor, apart: Tensor, spread: Tensor, power: Tensor
    ) -> Tensor:
        """Return one standard deviation of the counts, ``(batch, bend, site, facet, 3)``.

        The disagreement of the members, which light from all fibers shares, and the calibrated
        residual of every cell, independent from fiber to fiber, add in quadrature. ``apart`` is
        the deviation of every member's residual from their mean, ``(member, batch, ...)``.
        """
        members = apart.shape[0]
        batch, fibers, bends, sites, normals = transport.shape
        facets = normals - 1
        light = transport[..., :facets]
        weight = power.transpose(1, 2)  # (batch, colour, fiber)
        alone = (light * spread).reshape(batch, fibers, -1)
        variance = torch.matmul(weight * weight, alone * alone)
        if members > 1:
            lights = (apart[..., :facets] * light).reshape(members, batch, fibers, -1)
            together = torch.matmul(weight, lights)
            variance = variance + (together * together).sum(dim=0) / (members - 1)
        out = self.exposure * torch.sqrt(variance)
        return out.reshape(batch, 3, bends, sites, facets).permute(0, 2, 3, 4, 1)


def _within(x: Tensor, low: float, high: float) -> Tensor:
    """Move finite values into [low, high]; everything else becomes NaN, whatever clamp does."""
    return torch.where(
        torch.abs(x) < math.inf, torch.clamp(x, low, high), torch.full_like(x, math.nan)
    )


def _excess(x: Tensor, low: float, high: float) -> Tensor:
    """Return how far ``x`` lies outside [low, high], in units of the range; NaN gives inf."""
    width = high - low if high > low else 1.0
    outside = torch.relu(torch.maximum(x - high, low - x)) / width
    return torch.where(torch.abs(x) < math.inf, outside, torch.full_like(x, math.inf))
