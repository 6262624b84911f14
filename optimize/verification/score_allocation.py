"""Where renders change the answer: samples for the cells that move the scores of some designs.

To first order, the noise of a score is ``sum g x`` over the facets' light x, with the exact
derivatives g of S (`optimize.scoring.ScoreMerit`). A sample finds the light of all facets of a
site under one fiber, with errors relative to that light which differ from facet to facet and are
much the same for all fibers and sites (measured, tests/validation/RESULTS.md). So the noise of one
sample of a pair of site and fiber goes as ``sqrt(sum_facet (g T)^2)``, and so do the samples that
it should get (Neyman 1934; `render.reference.allocation`).

Designs that are rendered together are compared, so g is that of the difference to the leader, for
each of the others, and that of the leader's own score, which is reported too. Each counts in units
of the least variance that it could have: a small difference is to be known as well as a large one.

T and g are those of the model, never of the renders that they weigh, so estimates stay free of
bias, error bars hold, and the same question always gets the same samples. Where the model is wrong,
samples are spent less well, and nothing else is.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from optimize.design import Array, Design, ScoreSettings
from optimize.verification.design_renders import distinct_directions
from render.geometry import is_mirror_symmetric, mirror_image
from render.metric_gradient import score_by_counts
from render.reference import EVERYTHING, PRESSED, SampleAllocation
from render.scene import Scene
from render.transport import TransportTable

SAME = 1e-12
"""Variance of a difference, over that of the score, below which two designs are the same."""


def score_allocation(
    scene: Scene,
    table: TransportTable | None,
    settings: ScoreSettings,
    designs: Sequence[Design],
    *,
    leader: int = 0,
    rivals: Sequence[int] | None = None,
    untouched: bool = False,
) -> SampleAllocation:
    """Return the allocation for renders of ``designs``.

    Arguments:
        scene: the sensor.
        table: the model's, at the scene's bends. Without one, or where it has an axis of channels,
            samples are shared as usual.
        settings: of the scores.
        designs: all that are rendered together.
        leader: which one the others are compared with.
        rivals: which others matter (default: all).
        untouched: whether the untouched pads are needed too.
    """
    if table is None or table.by_channel:
        return SampleAllocation(None, untouched) if untouched else PRESSED
    phi, node = distinct_directions(designs)
    symmetric = is_mirror_symmetric(scene, phi)

    def moved(index: int) -> Array:
        """Return counts of S per relative change of a cell, ``(fiber, bend, site, facet)``."""
        design = designs[index]
        light = settings.exposure * table.at(np.clip(design.phi, table.phi.min(), table.phi.max()))
        counts = np.einsum("fbsk,fc->bskc", light, design.power)
        _, by_counts = score_by_counts(counts, settings.lam, settings.conventions)
        change = light * np.einsum("bskc,fc->fbsk", by_counts, design.power)
        if not symmetric:
            return np.asarray(change)
        # Renders of a symmetric sensor are the mean of what they found and its mirror image.
        nodes = np.zeros((len(change), phi.shape[1], *change.shape[1:]))
        nodes[:, node[index]] = change
        return np.asarray(0.5 * (change + mirror_image(scene, nodes, facets=True).sum(axis=1)))

    first = moved(leader)
    others = [i for i in (range(len(designs)) if rivals is None else rivals) if i != leader]
    variances = [(one**2).sum(axis=-1) for one in (first, *(moved(i) - first for i in others))]
    # The least variance that each of them could have alone is the unit of its own.
    units = [np.sqrt(variance).sum() ** 2 for variance in variances]
    total = sum(
        variance / unit
        for variance, unit in zip(variances, units, strict=True)
        if unit > SAME * units[0]
    )
    # (fiber, bend, site) -> (bend, site, fiber)
    shares = np.sqrt(np.broadcast_to(total, first.shape[:-1])).transpose(1, 2, 0)
    return SampleAllocation(shares, untouched)


def allocation_of(content: dict[str, Any] | None) -> SampleAllocation:
    """Return the allocation that a record holds as JSON, to the bit; without one, `EVERYTHING`."""
    if content is None:
        return EVERYTHING
    shares = content["shares"]
    return SampleAllocation(None if shares is None else np.array(shares), content["untouched"])


def allocation_digest(allocation: SampleAllocation) -> str:
    """Return a hash of the allocation, part of what was asked for; "" for everything alike."""
    if allocation.shares is None:
        return "" if allocation.untouched else "pressed"
    content = np.ascontiguousarray(allocation.shares, dtype="<f8").tobytes()
    return hashlib.sha256(content + bytes([allocation.untouched])).hexdigest()[:16]
