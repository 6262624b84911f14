"""The score of lightings on one transport table: singly with all details, or by the thousand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optimize.design import PARTS, Array, Colors, Design, SearchLimits, one_led, unlimited
from render.errors import TableError
from render.metric import (
    THESIS,
    MetricConfig,
    clip_counts,
    clipped_fraction,
    design_score,
    image_counts,
    site_metric,
)
from render.transport import TransportTable

# Lanes per kernel call: enough to amortise its overhead, few enough to stay in the cache.
LANES = 128
# Scores closer than this (relative) are the same number with other roundings.
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class ScoreDetails:
    """One lighting on one table, in counts.

    Arguments:
        score, mean, spread_sites, spread_bends: eq. (4.7) and its parts.
        metric: M of eq. (4.6), ``(bend, site)``.
        clipped: fraction of facets with a clipped channel.
    """

    score: float
    mean: float
    spread_sites: float
    spread_bends: float
    metric: Array
    clipped: float


class TableScorer:
    """Scores on ``table``: light is interpolated in phi, superposed, exposed, clipped, rated.

    Arguments:
        table: the transport table; all its cells are finite.
        config: the conventions of the metric.
        led_power: power of a chosen LED, ``(color,)`` or ``(F, color)`` per fiber and color,
            in [0, 1]; that of ``limits`` unless given. It applies wherever colors are chosen.
        limits: what searches on this scorer may choose, and of which palette; every color of the
            default one unless given.
    """

    def __init__(
        self,
        table: TransportTable,
        config: MetricConfig = THESIS,
        led_power: Array | None = None,
        limits: SearchLimits | None = None,
    ) -> None:
        self.table = table
        self.config = config
        self.fibers, _, self.bends, self.sites, self.facets = table.T.shape[:5]
        self.limits = limits or unlimited(self.fibers)
        power = np.asarray(
            self.limits.led_power if led_power is None else led_power, dtype=np.float64
        )
        self.palette = self.limits.palette
        colors, self.channels = self.palette.matrix.shape
        inside = ((power >= 0) & (power <= 1)).all()
        if power.shape not in {(colors,), (self.fibers, colors)} or not inside:
            raise TableError(
                f"led_power = {power.tolist()}, allowed: {colors} value{'s' * (colors != 1)} (or "
                f"{self.fibers} times {colors}) from 0 to 1",
                field="led_power",
            )
        if table.by_channel and table.T.shape[-1] != self.channels:
            raise TableError(
                f"the table has {table.T.shape[-1]} channels, allowed: {self.channels} as the "
                "scene's camera; name the scene that the table was made for",
                field="T",
            )
        self.led_power: Array = np.broadcast_to(power, (self.fibers, colors))
        exposed = table.exposure * table.T
        tinted = exposed if table.by_channel else exposed[..., None]
        # (channel or one for all, fiber, phi_node, cell)
        shape = (tinted.shape[-1], *exposed.shape[:2], -1)
        self._exposed = np.moveaxis(tinted, -1, 0).reshape(shape)
        # Says at once when the conventions do not fit the table, e.g. ddof = 1 with one bend.
        design_score(
            site_metric(np.ones((*table.T.shape[2:5], self.channels)), 0.0, config), config
        )

    @property
    def colors_alike(self) -> bool:
        """Whether exchanging two colors in all fibers changes no score and breaks no limit."""
        same_power = bool((self.led_power == self.led_power[:, :1]).all())
        alike = self.limits.colors_alike and self.palette.exchangeable
        return same_power and alike and not self.table.by_channel

    @property
    def phi_bounds(self) -> tuple[float, float]:
        """The directions in rad that the table covers, within [0, pi]; one node covers itself."""
        low, high = float(self.table.phi.min()), float(self.table.phi.max())
        return (low, high) if low == high else (max(0.0, low), min(float(np.pi), high))

    def at_node(self, index: int) -> Array:
        """Return phi ``(F,)`` rad with all fibers at direction node ``index`` of the table."""
        nodes = self.table.phi
        if not 0 <= index < len(nodes):
            raise TableError(
                f"phi index {index}, allowed: 0 to {len(nodes) - 1}", field="phi_index"
            )
        return np.full(self.fibers, nodes[index])

    def power(self, colors: Colors) -> Array:
        """Return light per channel ``(..., F, C)`` of ``colors`` ``(..., F)``; -1 is off."""
        return np.asarray(self._drive(colors) @ self.palette.matrix)

    def design(self, phi: Array, colors: Colors) -> Design:
        """Return the design with ``colors`` ``(F,)`` at the power of their LEDs."""
        return Design(phi, self._drive(colors), self.palette)

    def _drive(self, colors: Colors) -> Array:
        return one_led(colors, len(self.palette.names)) * self.led_power

    def light(self, phi: Array) -> Array:
        """Return counts per unit LED power, ``(F, B, S, K[, C])``, for ``phi`` ``(F,)`` rad."""
        self._check_phi(phi)
        return self.table.exposure * self.table.at(phi)

    def score(self, phi: Array, power: Array) -> float:
        """Return S (eq. 4.7) for ``phi`` ``(F,)`` rad and ``power`` ``(F, C)``."""
        return self.details(phi, power).score

    def details(self, phi: Array, power: Array) -> ScoreDetails:
        """Return S with its parts and its map for ``phi`` ``(F,)`` rad and ``power`` ``(F, C)``."""
        counts = self.counts(self.light(phi), np.asarray(power, np.float64))
        metric = site_metric(counts, self.table.lam, self.config)
        parts = design_score(metric, self.config)
        return ScoreDetails(
            **{name: float(getattr(parts, name)) for name in PARTS},
            metric=metric,
            clipped=float(clipped_fraction(counts, self.config)),
        )

    def counts(self, light: Array, power: Array) -> Array:
        """Return clipped counts ``(B, S, K, C)`` of ``light`` under ``power`` ``(F, C)``."""
        if self.table.by_channel:
            return np.asarray(clip_counts(np.einsum("fbskc,fc->bskc", light, power), self.config))
        return np.asarray(image_counts(light, power, 1.0, self.config))

    def scores(self, colors: Colors, phi: Array) -> Array:
        """Return S ``(N,)`` of ``colors`` ``(N, F)``, all with the same ``phi`` ``(F,)`` rad."""
        light = self.light(phi)
        tinted = "c" if self.table.by_channel else ""
        light = light.reshape(self.fibers, -1, *light.shape[4:])
        out = np.empty(len(colors))
        for start in range(0, len(colors), LANES):
            power = self.power(colors[start : start + LANES])
            block = np.einsum(f"fx{tinted},nfc->xcn", light, power, optimize=True)
            out[start : start + LANES] = self.score_block(block)
        return out

    def direction_scores(self, phi: Array, power: Array) -> Array:
        """Return S ``(N,)`` of directions ``phi`` ``(N, F)`` rad under one ``power`` ``(F, C)``."""
        from render.chebyshev import interpolation_weights

        self._check_phi(phi)
        out = np.empty(len(phi))
        for start in range(0, len(phi), LANES):
            weights = interpolation_weights(self.table.phi, phi[start : start + LANES])
            block = np.empty((self._exposed.shape[-1], self.channels, len(weights)))
            for channel in range(self.channels):
                lit = np.flatnonzero(power[:, channel])
                mixed = weights[:, lit] * power[lit, channel, None]
                table = self._exposed[channel if self.table.by_channel else 0]
                table = table[lit].reshape(-1, block.shape[0])
                block[:, channel] = table.T @ mixed.reshape(len(weights), -1).T
            out[start : start + LANES] = self.score_block(block)
        return out

    def score_block(self, block: Array) -> Array:
        """Return S ``(lane,)`` of unclipped counts ``(B * S * K, C, lane)``."""
        # Numba takes half a second to import.
        from optimize.scoring.metric_kernel import channel_mark, kernel_constants, score_lanes

        cells = self.bends * self.sites
        base = np.zeros((cells, self.facets, self.channels))
        constants = kernel_constants(self.config, self.table.lam, np.float64)
        mark = channel_mark(self.channels, np.float64)
        out = np.empty(block.shape[-1])
        for start in range(0, len(out), LANES):
            lanes = np.ascontiguousarray(block[..., start : start + LANES])
            lanes = lanes.reshape(cells, self.facets, self.channels, -1)
            score_lanes(base, lanes, self.bends, constants, mark, out[start : start + LANES])
        return out

    def _check_phi(self, phi: Array) -> None:
        if phi.shape[-1:] != (self.fibers,):
            raise TableError(
                f"phi has shape {phi.shape}, allowed: {self.fibers} directions", field="phi"
            )
        low, high = self.phi_bounds
        bad = ~((phi >= low) & (phi <= high))
        if bad.any():
            value = float(phi[bad].flat[0])
            raise TableError(
                f"phi = {value:g} rad, allowed: {low:g} to {high:g} rad, which the table covers",
                field="phi",
            )


def improves(score: float, best: float) -> bool:
    """Return whether ``score`` is above ``best`` by more than rounding."""
    return score > best + ROUNDING * abs(best)
