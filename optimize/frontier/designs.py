"""Random designs that nothing was fitted to, and the direction nodes that render all of them.

Directions are continuous: no design stands on a node that a surrogate was trained at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.geometry.layout import fiber_edges, mirrored_fibers
from render.scene.schema import Scene
from surrogate.training.evaluation import random_colors


@dataclass(frozen=True)
class HeldOut:
    """Random lighting designs.

    Arguments:
        phi: ``(design, fiber)`` rad, uniform in [0, pi].
        power: ``(design, fiber, 3)``, one color per fiber at full power.
    """

    phi: Array
    power: Array

    def __len__(self) -> int:
        """Return the number of designs."""
        return len(self.phi)


def held_out_designs(scene: Scene, count: int, seed: int) -> HeldOut:
    """Return ``count`` random designs of ``scene``; the same for the same seed."""
    rng = np.random.default_rng([seed, 11])
    fibers = scene.fibers.count
    return HeldOut(rng.uniform(0.0, np.pi, (count, fibers)), random_colors(count, fibers, rng))


@dataclass(frozen=True)
class Nodes:
    """Direction nodes of one render that hold all designs.

    Arguments:
        phi: ``(fiber, node)`` rad.
        index: ``(design, fiber)``, the node at which a fiber stands in a design.
    """

    phi: Array
    index: np.ndarray

    def of_designs(self, transport: Array) -> Array:
        """Return ``(design, fiber, ...)`` of transport per node ``(fiber, node, ...)``."""
        return np.asarray(transport[np.arange(len(self.phi)), self.index])


def shared_nodes(scene: Scene, designs: HeldOut) -> Nodes:
    """Return nodes for one render of all designs, since its light paths serve every node.

    On a sensor with mirrored fibers the mirror images of all directions join them: the renderer
    then averages mirrored cells, which halves the variance for little more time.
    """
    count, fibers = designs.phi.shape
    here = designs.phi.T
    number = np.tile(np.arange(count)[:, None], (1, fibers))
    if scene.fibers.left != scene.fibers.right or scene.sites.centre_x != 0.0:
        return Nodes(here, number)
    twin, fiber = mirrored_fibers(scene), np.arange(fibers)
    tip = np.array([edge == "tip" for edge in fiber_edges(scene)])
    # Mirrored sides need equal lists: first the directions of the lower-numbered fiber. At the tip
    # phi becomes pi - phi and the order of the nodes turns round.
    sides = [here[np.minimum(fiber, twin)], here[np.maximum(fiber, twin)]]
    tips = [here, np.pi - here[twin, ::-1]]
    phi = np.where(tip[:, None], np.concatenate(tips, axis=1), np.concatenate(sides, axis=1))
    return Nodes(phi, np.where(~tip & (fiber > twin), number + count, number))
