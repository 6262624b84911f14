"""Several designs rendered together: one Metropolis run serves all of their directions.

Every design is one direction node of the run, so all of them are lit by the same light paths. Noise
of the paths and of the image's overall scale is then common to the designs and cancels in their
differences, and ten designs cost little more than one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from optimize.design.design import Array, Design
from optimize.scoring.rendered_score import check_visible
from render.progress import Progress
from render.reference.transport import JobRunner, render_transport
from render.scene.schema import Scene


@dataclass(frozen=True, eq=False)
class DesignRenders:
    """What one run says about some designs, with independent replicates on the first axis.

    Arguments:
        designs: in the order of the axis ``design``.
        replicates: transport ``(replicate, design, fiber, bend, site, facet)``.
        background: of the untouched pad, ``(replicate, design, fiber, bend, site)``.
        seconds: spent on rendering, all attempts together.
    """

    designs: tuple[Design, ...]
    replicates: Array
    background: Array
    seconds: float


class RenderDesigns(Protocol):
    """Renders designs together, at the scene's bends."""

    def __call__(
        self, designs: Sequence[Design], *, samples: int, seeds: Sequence[int], title: str
    ) -> DesignRenders:
        """Return the renders; ``samples`` per (fiber, facet) pair and seed."""


def reference_renders(
    scene: Scene,
    checkpoint: Path | None,
    progress: Callable[[str, Progress], None] | None = None,
    runner: JobRunner | None = None,
) -> RenderDesigns:
    """Return what renders designs of ``scene`` at level 2.

    It goes on from ``checkpoint``; a ``runner`` runs the jobs elsewhere and keeps its own.
    """
    bends = np.array(scene.bending.angles)

    def render(
        designs: Sequence[Design], *, samples: int, seeds: Sequence[int], title: str
    ) -> DesignRenders:
        phi, node = distinct_directions(designs)
        found = render_transport(
            scene,
            phi,
            bends,
            samples=samples,
            seeds=seeds,
            checkpoint=checkpoint,
            runner=runner,
            progress=None if progress is None else lambda state: progress(title, state),
        )
        check_visible(found.replicates)
        # (replicate, fiber, node, ...) -> (replicate, design, fiber, ...)
        return DesignRenders(
            tuple(designs),
            found.replicates[:, :, node].swapaxes(1, 2),
            found.background_replicates[:, :, node].swapaxes(1, 2),
            found.seconds,
        )

    return render


def distinct_directions(designs: Sequence[Design]) -> tuple[Array, np.ndarray]:
    """Return ``(fiber, node)`` rad without repeats, and the node of every design.

    Designs that differ in their colors alone share a node: light is linear.
    """
    kept: list[Array] = []
    node = []
    for design in designs:
        known = [i for i, phi in enumerate(kept) if np.array_equal(phi, design.phi)]
        if not known:
            known = [len(kept)]
            kept.append(design.phi)
        node.append(known[0])
    return np.stack(kept, axis=1), np.array(node)
