"""What the untouched pad must look like, one fiber at a time, and how a photograph shows it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hw.camera.led_colors import own_channels
from hw.camera.projection import pad_positions
from render.arrays import Array
from render.chebyshev import chebyshev_nodes, interpolation_weights
from render.geometry import flat_sites
from tactilux import Checker, Scene

NODES = 13
"""Direction nodes at which the model is asked; between them light is a polynomial in phi."""
MIN_OWN = 0.05
"""Power of an LED over the fiber's strongest one from which it counts as lit."""
MIN_TURNED = 1e-4
"""Change of a fiber's light with direction, over its brightest, from which there is one."""


@dataclass(frozen=True, eq=False)
class PadPrediction:
    """The background of a design, fiber by fiber.

    Arguments:
        phi: ``(fiber,)`` rad, the design's directions.
        power: ``(fiber, color)`` in [0, 1], the design's powers of its LEDs.
        nodes: ``(node,)`` rad.
        table: ``(fiber, node, site)`` counts per unit power; with one more axis ``channel`` where
            the skin's albedo depends on it.
        score: the design's score over the scene's bends or states, in counts.
        domain_excess: 0 inside the model's trained range.
        response: ``(color, channel)``, what each channel sees of each LED color.
    """

    phi: Array
    power: Array
    nodes: Array
    table: Array
    score: float
    domain_excess: float
    response: Array = field(default_factory=lambda: np.eye(3))

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Which fibers the design lights, ``(fiber,)``."""
        return np.asarray(np.any(self.power, axis=1))

    @property
    def seen_power(self) -> Array:
        """What each channel sees of each fiber's power, ``(fiber, channel)``."""
        return np.asarray(self.power @ self.response)

    def unit(self, phi: Array) -> Array:
        """Return counts per unit power ``(fiber, n, site[, channel])``, as the table has them.

        ``phi`` is ``(fiber, n)`` rad.
        """
        weights = interpolation_weights(self.nodes, phi)
        found = np.einsum("fnj,fjs...->fns...", weights, self.table)
        # A polynomial through nearly dark nodes may dip below 0; light does not.
        return np.asarray(np.maximum(found, 1e-6 * self.table.max()))

    def tinted(self, phi: Array) -> Array:
        """Return `unit` ``(fiber, n, site, channel)``, of one channel where all are alike."""
        found = self.unit(phi)
        return found if self.table.ndim == 4 else found[..., None]

    @property
    def own(self) -> NDArray[np.bool_]:
        """In which channels each fiber shines with an LED of their own, ``(fiber, channel)``."""
        return shone_channels(self.power, self.response)

    @property
    def one_led(self) -> NDArray[np.bool_]:
        """Which fibers shine with one LED, ``(fiber,)``."""
        return np.asarray(shining(self.power).sum(axis=1) == 1)

    @property
    def turns(self) -> NDArray[np.bool_]:
        """Which fibers' light is known to change as they turn, ``(fiber,)``.

        Not that of lamps which cannot: the model has one direction of theirs.
        """
        change = np.ptp(self.table, axis=1).reshape(len(self.table), -1).max(axis=1)
        return np.asarray(change > MIN_TURNED * self.table.reshape(len(change), -1).max(axis=1))

    @property
    def cells(self) -> tuple[int, int]:
        """Numbers of fibers and sites."""
        return self.table.shape[0], self.table.shape[2]

    @property
    def alone(self) -> Array:
        """Counts of each fiber alone with its power, ``(fiber, site, channel)``."""
        return self.tinted(self.phi[:, None])[:, 0] * self.seen_power[:, None, :]

    @property
    def tint(self) -> Array:
        """Light of each channel over that of all, per unit power, ``(fiber, channel)``."""
        light = self.tinted(self.phi[:, None])[:, 0].sum(axis=1)
        return np.asarray(light / light.mean(axis=1, keepdims=True))

    @property
    def together(self) -> Array:
        """Counts of all fibers together, ``(site, channel)``."""
        return np.asarray(self.alone.sum(axis=0))


def shining(power: Array) -> NDArray[np.bool_]:
    """Return which LEDs of ``power`` ``(fiber, color)`` count as lit."""
    return np.asarray(power > MIN_OWN * power.max(axis=1, keepdims=True))


def shone_channels(power: Array, response: Array) -> NDArray[np.bool_]:
    """Return the own channels of the LEDs that are lit, ``(n, channel)``.

    Of ``power`` ``(n, color)`` with LEDs that ``response`` ``(color, channel)`` tells.
    """
    return np.asarray(shining(power).astype(np.int64) @ own_channels(response) > 0)


def predict(
    checker: Checker, phi: Array, power: Array, bend: float, response: Array | None = None
) -> PadPrediction:
    """Ask the model for the background of a design at ``bend``, once per design.

    ``bend`` is rad, or the number of a state of the skin.

    ``response`` ``(color, channel)`` None: each channel sees the color of its name alone.

    Light is linear, so as many fibers are lit per run of the model as there are channels.
    """
    nodes = chebyshev_nodes(NODES, 0.0, np.pi)
    table = checker.transport_table(nodes, np.array([bend]))
    assert table.background is not None
    response = np.eye(3) if response is None else response
    seen = power @ response
    whole = checker.run(phi[None], seen[None], np.array(checker.metadata.scene_bends))
    here = checker.run(phi[None], seen[None], np.array([bend]))
    return PadPrediction(
        phi=np.asarray(phi, dtype=np.float64),
        power=np.asarray(power, dtype=np.float64),
        nodes=nodes,
        table=table.background[:, :, 0] * checker.exposure,
        score=float(whole["score"][0]),
        domain_excess=float(here["domain_excess"][0]),
        response=response,
    )


RADIUS = 1.0
"""Radius (mm) of the spot that is averaged: far more pixels than the model's own spots have, and
on the untouched pad light changes little over it."""


class SiteSpots:
    """Which pixels show each site's spot at a ``bend`` in rad; used for every photograph.

    ``scene`` stays in one state (`render.geometry.in_state`), whose skin carries the sites.
    ``counts`` ``(site,)`` are pixels per site, ``pad`` ``(row, column)`` where the camera sees it;
    photographs have the camera's columns and rows.
    """

    def __init__(self, scene: Scene, bend: float) -> None:
        flat = pad_positions(scene, bend, scene.camera.rows, scene.camera.columns)
        self.pad: NDArray[np.bool_] = np.isfinite(flat[..., 0])
        flat = flat.reshape(-1, 2)
        away = np.linalg.norm(flat - flat_sites(scene)[:, None, :2], axis=-1)
        self._shown = (away <= RADIUS).astype(np.float64)
        self.counts = self._shown.sum(axis=1)

    def colors(self, photo: Array) -> Array:
        """Return mean colors ``(site, channel)`` of a ``photo``, NaN where unseen.

        It is ``(row, column, channel)``.
        """
        with np.errstate(invalid="ignore"):
            return np.asarray(
                self._shown @ photo.reshape(-1, photo.shape[2]) / self.counts[:, None]
            )
