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

from render.arrays import Array
from render.metric import clip_counts, design_score, site_metric
from render.scene import Scene
from surrogate.model.facet_basis import Expansion, store_constants
from surrogate.model.features import BRIGHTNESS, CellFeatures
from surrogate.model.lamp_copies import channel_mask
from surrogate.model.materials import MaterialRange
from surrogate.model.preview_grid import PreviewGrid

SAME_BEND = 1e-6
"""Bends that differ by less are one, rad."""


class CheckerOutputs(NamedTuple):
    """Outputs of the checker, named and shaped as in the ONNX contract."""

    counts: Tensor
    counts_spread: Tensor
    background: Tensor
    metric: Tensor
    score: Tensor
    domain_excess: Tensor


class PreviewTable(nn.Module):
    """The interpolated log preview: ``(normal, batch, fiber, bend, site)``."""

    table: Tensor
    slopes: Tensor

    def __init__(self, grid: PreviewGrid) -> None:
        """Store the values of ``grid`` at its nodes as float32 constants."""
        super().__init__()
        # (fiber, phi node, bend node, normal, site), the last three in one axis.
        table = grid.log_transport.swapaxes(-1, -2)
        self.shape = table.shape
        store_constants(self, {"table": table.reshape(table.shape[0], table.shape[1], -1)})
        self.in_phi, self.in_bend = Lagrange(grid.phi), Lagrange(grid.bends)
        self.terms = None
        if grid.free is not None and grid.slopes is not None:
            self.terms = MaterialTerms(grid.free)
            # (fiber, term and phi node, rest). A logarithm's small part: half precision is within
            # 1e-3 of it, and the file stays below its limit.
            slopes = np.moveaxis(grid.slopes.swapaxes(-1, -2), 0, 1)
            slopes = slopes.reshape(table.shape[0], -1, self.table.shape[2])
            self.register_buffer("slopes", torch.as_tensor(slopes, dtype=torch.float16))

    def forward(self, phi: Tensor, bend: Tensor, material: Tensor | None = None) -> Tensor:
        """Return the log preview for ``phi`` ``(batch, fiber)``, ``bend`` ``(batch, bend)``.

        ``material`` is ``(batch, quantity)`` in [-1, 1], where the scene leaves it free.
        """
        fibers, _, nodes, normals, sites = self.shape
        # (fiber, batch, phi node) x (fiber, phi node, rest), then (bend, node) x (node, rest).
        in_phi = self.in_phi(phi).transpose(0, 1)
        at_phi = torch.matmul(in_phi, self.table)
        if self.terms is not None and material is not None:
            both = self.terms(material)[:, :, None] * in_phi[:, :, None, :]
            at_phi = at_phi + torch.matmul(both.flatten(2), self.slopes.float())
        at_phi = at_phi.reshape(fibers, -1, nodes, normals * sites)
        out = torch.matmul(self.in_bend(bend), at_phi)
        return out.reshape(fibers, out.shape[1], -1, normals, sites).permute(3, 1, 0, 2, 4)


class MaterialTerms(nn.Module):
    """The polynomial terms ``(batch, term)`` of a free material ``(batch, quantity)``.

    See :meth:`surrogate.model.materials.MaterialRange.terms`; the material comes mapped to [-1, 1].
    """

    nominal: Tensor

    def __init__(self, free: MaterialRange) -> None:
        super().__init__()
        self.exponents = free.exponents.tolist()
        store_constants(self, {"nominal": free.nominal_terms})

    def forward(self, material: Tensor) -> Tensor:
        """Return the terms, 0 at the scene's own material."""
        columns = []
        for powers in self.exponents:
            product = torch.ones_like(material[:, 0])
            for quantity, power in enumerate(powers):
                for _ in range(power):
                    product = product * material[:, quantity]
            columns.append(product)
        return torch.stack(columns, dim=1) - self.nominal


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


class CheckerModule(nn.Module):
    """From a lighting design to the colors it must produce, with their uncertainty.

    Arguments of the constructor:
        scene: the sensor.
        grid: its preview.
        residual: model of log(T_reference / T_preview), see ``networks``.
        exposure: counts per unit of radiance; lam: weight of M_phi in eq. (4.6).
        spread: ``(b0, b1)``: log of the standard deviation of one cell's residual is
            ``b0 + b1 z``, with z the standardized log preview of the untouched pad.
    """

    logarithmic: Tensor
    seen: Tensor

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
        super().__init__()
        self.preview, self.inputs = PreviewTable(grid), CellFeatures(scene, grid)
        self.residual, self.expansion = residual, Expansion(scene)
        self.exposure, self.lam, self.spread = exposure, lam, spread
        self.channels = len(scene.palette.channels)
        self.bends = (float(grid.bends.min()), float(grid.bends.max()))
        self.states = scene.states is not None
        self.copies, self.free = len(scene.albedos), grid.free
        if scene.by_channel:
            store_constants(self, {"seen": channel_mask(scene).T[..., None]})
        if grid.free is not None:
            store_constants(self, {"logarithmic": grid.free.logarithmic.astype(float)})

    def forward(
        self, phi: Tensor, power: Tensor, bend: Tensor, material: Tensor | None = None
    ) -> CheckerOutputs:
        """Return the prediction.

        Arguments:
            phi: ``(batch, fiber)`` rad.
            power: ``(batch, fiber, channel)`` in [0, 1].
            bend: ``(batch, bend)`` rad, or numbers of named states.
            material: ``(batch, quantity)``, where the scene leaves it free, in the units of
                :mod:`surrogate.model.materials`.

        Inputs outside their range are moved to its edge and reported in ``domain_excess``;
        inputs that are not finite give NaN.
        """
        given = self._scaled(phi, power, bend, material)
        inside = _within(given)
        fibers, width = phi.shape[1], self.bends[1] - self.bends[0]
        lights = fibers + self.channels * fibers
        free = lights + (0 if material is None else material.shape[1])
        bends = inside[:, free:] * width + self.bends[0]
        if self.states:
            bends = torch.round(bends[:, : bend.shape[1]])
        log_preview, residual, spread = self.transport(
            torch.cat([inside[:, :fibers]] * self.copies, dim=1) * math.pi,
            bends,
            None if material is None else 2.0 * inside[:, lights:free] - 1.0,
        )
        weight = inside[:, fibers:lights].reshape(-1, self.channels, fibers)
        if self.copies > 1:
            # (batch, channel, albedo, fiber): a copy shines into the channels of its albedo.
            weight = (weight[:, :, None] * self.seen).flatten(2)
        shared = residual.sum(dim=0) / residual.shape[0]
        transport = torch.exp(log_preview + shared)
        counts = clip_counts(self.exposure * _superposed(weight, transport))
        facets = counts[..., :-1, :]
        metric = site_metric(facets, self.lam)
        return CheckerOutputs(
            counts=facets,
            counts_spread=self.counts_spread(transport, residual - shared, spread, weight),
            background=counts[..., -1, :],
            metric=metric,
            score=design_score(metric).score,
            domain_excess=_excess(given).amax(dim=1),
        )

    def _scaled(self, phi: Tensor, power: Tensor, bend: Tensor, material: Tensor | None) -> Tensor:
        """Return all inputs of a design in one row, 0 to 1 inside the trained range.

        ``(batch, fiber + channel fiber + quantity + bend)``; power by channel first.
        """
        low, high = self.bends
        if high > low:
            level = (bend - low) / (high - low)
        else:
            # Any other bend than the one is outside, on the one side that is below 0.
            level = -torch.relu(torch.abs(bend - low) - SAME_BEND)
        if self.states:
            # There is nothing between states: what is no whole number is outside, below 0 too.
            between = -torch.relu(torch.abs(bend - torch.round(bend)) - SAME_BEND)
            level = torch.cat([level, between], dim=1)
        colors = power.transpose(1, 2).flatten(1)
        if material is None or self.free is None:
            return torch.cat([phi / math.pi, colors, level], dim=1)
        ends = np.stack([self.free.low, self.free.high])
        start, stop = np.where(self.free.logarithmic, np.log(ends), ends)
        # The logarithm of what is not positive is not finite, and gives NaN as such input does.
        value = torch.where(self.logarithmic > 0.5, torch.log(material), material)
        columns = [
            (value[:, i : i + 1] - float(a)) / float(b - a)
            for i, (a, b) in enumerate(zip(start, stop, strict=True))
        ]
        return torch.cat([phi / math.pi, colors, *columns, level], dim=1)

    def transport(
        self, phi: Tensor, bend: Tensor, material: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return log preview, residual of every member and standard deviation of the residual.

        Shapes ``(normal, batch, fiber, bend, site)``, the same with ``member`` in front, and
        ``(batch, fiber, bend, site)``; the untouched pad is the last normal. ``material`` is in
        [-1, 1].
        """
        log_preview = self.preview(phi, bend, material)
        x = self.inputs(phi, bend, log_preview, material)
        coefficients = self.residual(x.reshape(x.shape[0], -1).t()).transpose(1, 2)
        coefficients = coefficients.reshape(coefficients.shape[0], -1, *x.shape[1:])
        residual = self.expansion(coefficients, log_preview)
        spread = torch.exp(self.spread[0] + self.spread[1] * x[BRIGHTNESS])
        return log_preview, residual, spread

    def counts_spread(
        self, transport: Tensor, deviation: Tensor, spread: Tensor, weight: Tensor
    ) -> Tensor:
        """Return one standard deviation of the counts, ``(batch, bend, site, facet, channel)``.

        The disagreement of the members, which light from all fibers shares, and the calibrated
        residual of every cell, independent from fiber to fiber, add in quadrature. ``deviation`` is
        the deviation of every member's residual from their mean, ``(member, normal, batch, ...)``;
        ``weight`` the power ``(batch, channel, fiber)``.
        """
        members = deviation.shape[0]
        variance = _superposed(weight * weight, (transport * spread) ** 2)
        if members > 1:
            together = _superposed(weight, deviation * transport)
            variance = variance + (together * together).sum(dim=0) / (members - 1)
        return self.exposure * torch.sqrt(variance[..., :-1, :])


def _superposed(weight: Tensor, light: Tensor) -> Tensor:
    """Return ``(..., batch, bend, site, normal, channel)``: light adds up over the fibers.

    ``weight`` is ``(batch, channel, fiber)``,
    ``light`` ``(..., normal, batch, fiber, bend, site)``.
    """
    bends, sites = light.shape[-2:]
    sums = torch.matmul(weight, light.flatten(-2))
    sums = sums.reshape(*sums.shape[:-1], bends, sites)
    lead = list(range(light.ndim - 5))
    normal, batch, color, bend, site = range(light.ndim - 5, light.ndim)
    return sums.permute(*lead, batch, bend, site, normal, color)


def _within(x: Tensor) -> Tensor:
    """Move finite values into [0, 1]; everything else becomes NaN, whatever clamp does."""
    return torch.where(torch.abs(x) < math.inf, torch.clamp(x, 0.0, 1.0), math.nan)


def _excess(x: Tensor) -> Tensor:
    """Return how far ``x`` lies outside [0, 1]; what is not finite gives inf."""
    outside = torch.relu(torch.maximum(x - 1.0, -x))
    return torch.where(torch.abs(x) < math.inf, outside, math.inf)
