"""The yardstick: one long render of all held-out designs together, with its error bars."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from optimize.frontier.designs import HeldOut, Nodes
from optimize.scoring.jackknife import jackknife
from render.arrays import Array
from render.errors import RenderError
from render.metric import clip_counts, design_score, image_counts, site_metric
from render.progress import Progress
from render.reference.job import Sampler
from render.reference.transport import Estimate, render_transport
from render.scene.schema import Scene

REFERENCE_SEED, SHORT_SEED = 101, 201
"""Seeds of the long render and of the short ones; training renders count from 1."""


@dataclass(frozen=True)
class Reference:
    """Counts and scores of the held-out designs at level 2.

    Arguments:
        counts, counts_se: ``(design, bend, site, facet, 3)`` and one standard error.
        scores, scores_se: ``(design,)``, freed of the noise's bias by the jackknife.
        exposure, lam: of the scene.
        samples: per fiber and facet.
        replicates: independent groups of chains behind the error bars.
        seconds: of the render.
    """

    counts: Array
    counts_se: Array
    scores: Array
    scores_se: Array
    exposure: float
    lam: float
    samples: int
    replicates: int
    seconds: float


def render_designs(
    scene: Scene,
    nodes: Nodes,
    *,
    samples: int,
    seed: int,
    checkpoint: Path,
    sampler: Sampler = "monte-carlo",
    progress: Callable[[Progress], None] | None = None,
) -> Estimate:
    """Render every design of ``nodes`` at the scene's bends in one go; resumes in ``checkpoint``.

    Raises:
        RenderError: no light, or a facet that the camera cannot see.
    """
    estimate = render_transport(
        scene,
        nodes.phi,
        np.array(scene.bending.angles),
        samples=samples,
        seeds=[seed],
        sampler=sampler,
        checkpoint=checkpoint,
        progress=progress,
    )
    hidden = np.argwhere(~np.isfinite(estimate.replicates).all(axis=(0, 1, 2)))
    if len(hidden):
        bend, site, facet = (int(i) for i in hidden[0])
        raise RenderError(
            f"the camera cannot see {len(hidden)} facets, the first is facet {facet} of site "
            f"{site} at bend {bend}, so designs have no score: move the sites or the camera",
            field="sites",
        )
    return estimate


def judge(
    estimate: Estimate, nodes: Nodes, designs: HeldOut, exposure: float, lam: float
) -> Reference:
    """Return counts and scores of the designs with error bars from the estimate's replicates."""
    replicates = np.stack([nodes.of_designs(one) for one in estimate.replicates])
    light = np.einsum("rdfbsk,dfc->rdbskc", replicates, designs.power, optimize=True) * exposure
    parts = [
        jackknife(lambda counts: _score(counts, lam), light[:, design])
        for design in range(len(designs))
    ]
    count = len(replicates)
    return Reference(
        counts=np.asarray(
            image_counts(nodes.of_designs(estimate.T), designs.power, exposure), dtype=np.float64
        ),
        counts_se=light.std(axis=0, ddof=1) / np.sqrt(count),
        scores=np.array([part.value for part in parts]),
        scores_se=np.array([part.se for part in parts]),
        exposure=exposure,
        lam=lam,
        samples=int(str(estimate.settings["samples_per_cell"])),
        replicates=count,
        seconds=estimate.seconds,
    )


def _score(light: Array, lam: float) -> float:
    """Return S of counts ``(bend, site, facet, 3)`` before clipping."""
    return float(design_score(site_metric(clip_counts(light), lam)).score)
