"""Standard errors of transport cells from replicates, also of cells that no path has lit yet.

The spread of few replicates of rare contributions is a poor error bar, and short where the cell
came out dark: intervals missed light that was still to be found. What a run adds up is a compound
Poisson process: the variance of a mean over the mean is the size of one contribution (weighted by
size), however many there were. That size is similar for the facets of one site, which share their
light subpaths, so a second variance comes from all of them. Both are averaged in the logarithm,
each by how little it errs (empirical Bayes, as in Smyth 2004): how much facets really differ is
what two halves of the replicates agree on.

Replicates that all found nothing say that fewer than three contributions are to be expected (the
rule of three: e^-3 is 5 %), each taken to be as large as in cells that are lit by the same fiber
from the same direction at other sites: those of the same site share its bad luck.

Of light that comes by few, bright contributions replicates know too little even where a cell is
lit: most cells have not met one. A *lone* contribution carries more than a third of its cell. Such
a cell has at least the standard error of an unlit one: one and a half contributions, half its light
or more. And what happened to one cell could have happened to the others that the same fiber lights
from the same direction: the mean square of their lone contributions, which is the variance of such
a process, is added to the variance of all of them, as it is or in proportion to the light of their
untouched sites, whichever is less: far sites get less light, and fainter contributions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from render.arrays import Array

FACET_AXES = (4,)
# Axes of the cells whose contributions an unlit one borrows: more where those are unlit too.
PEER_AXES = ((3, 4), (1, 3, 4), (0, 1, 3, 4), (0, 1, 2, 3, 4))
UNLIT_CONTRIBUTIONS = 1.5
"""Contributions in the standard error of an unlit cell: two standard errors are three of them."""
LONE_SHARE = 1 / 3
"""Share of a cell's light from which its largest contribution is a lone one."""


@dataclass(frozen=True)
class CellErrors:
    """Mean, standard error and largest contribution of cells, as parts of the mean.

    Axes ``(fiber, phi_node, bend, site[, facet])``; NaN where the camera sees nothing. ``effort``
    are the samples of the cells, in any unit and of a shape that broadcasts; None for all alike.
    """

    mean: Array
    error: Array
    largest: Array
    effort: Array | None = None

    @property
    def lone(self) -> Array:
        """Contributions that carry more than LONE_SHARE of their cell, else 0; NaN unseen."""
        none = self.largest <= LONE_SHARE * self.mean
        return np.where(none, 0.0, self.largest)


def with_lone_contributions(
    facets: CellErrors, sites: CellErrors, effort: float
) -> tuple[Array, Array]:
    """Return the standard errors of facets and of untouched sites with what lone light adds.

    Arguments:
        facets: cells of the pressed pad.
        sites: cells of the untouched pad, under the same fibers from the same directions.
        effort: samples of a site over those of a facet, on average; variances of a mean fall as 1
            over it, and as 1 over the facets' own.
    """
    lone, alone = facets.lone, sites.lone
    each = 1.0 if facets.effort is None else np.sqrt(facets.effort)
    seen = np.isfinite(lone).sum(axis=(3, 4)) + np.isfinite(alone).sum(axis=3)

    def shared(scale: Array) -> Array:
        """Return what peers' lone contributions add to a cell, in units of ``scale`` of sites."""
        squares = np.nansum((each * lone / scale[..., None]) ** 2, axis=(3, 4))
        squares = squares + effort * np.nansum((alone / scale) ** 2, axis=3)
        return np.asarray(np.sqrt(squares / np.maximum(seen, 1))[..., None] * scale)

    # Sites that are dark or unseen have no light to compare with.
    light = np.where(sites.mean > 0, sites.mean, np.nan)
    common = np.fmin(shared(np.ones_like(light)), shared(light))
    errors = (
        (facets, lone, common[..., None] / each),
        (sites, alone, common / np.sqrt(effort)),
    )
    pressed, untouched = (
        np.hypot(np.maximum(cells.error, UNLIT_CONTRIBUTIONS * single), common)
        for cells, single, common in errors
    )
    return pressed, untouched


def standard_error(replicates: Array, effort: Array | None = None) -> Array:
    """Return the standard error of the mean over the first axis; above 0 where any cell is lit.

    Arguments:
        replicates: independent estimates ``(replicate, fiber, phi_node, bend, site[, facet])``,
            at least 0.
        effort: samples of the cells, as of `CellErrors`: a contribution to a mean is as small as
            they are many.
    """
    each = 1.0 if effort is None else effort
    mean, variance = _moments(replicates)
    weight = shared_weight(replicates)
    shared_variance = mean * _contribution(mean, variance, FACET_AXES)
    error = np.sqrt(variance ** (1.0 - weight) * shared_variance**weight)
    unlit = mean == 0
    for axes in PEER_AXES:
        if not unlit.any():
            break
        size = _contribution(mean, each * variance, axes) / each
        error = np.where(unlit, UNLIT_CONTRIBUTIONS * size, error)
        unlit = unlit & (size == 0)
    return np.asarray(error)


def shared_weight(replicates: Array) -> float:
    """Return the weight in [0, 1] of the variance that the facets of a site share.

    ``replicates`` are those of ``standard_error``; 0 without facets or with fewer than four.
    """
    if replicates[0].ndim <= FACET_AXES[0] or len(replicates) < 4:
        return 0.0
    half = len(replicates) // 2
    logs = []
    for part in (replicates[:half], replicates[half:]):
        mean, variance = _moments(part)
        ratio = np.full(mean.shape, np.nan)
        np.divide(
            variance,
            mean * _contribution(mean, variance, FACET_AXES),
            out=ratio,
            where=variance > 0,
        )
        logs.append(np.log(ratio))
    known = np.isfinite(logs[0]) & np.isfinite(logs[1])
    if known.sum() < 2:
        return 0.0
    (first, common), (_, second) = np.cov(logs[0][known], logs[1][known])
    differing = max(float(common), 0.0)
    # Of all replicates together the noise is half of that of each half.
    noise = 0.5 * max(0.5 * float(first + second) - differing, 0.0)
    return noise / (noise + differing) if noise > 0 else 0.0


def _moments(replicates: Array) -> tuple[Array, Array]:
    """Return mean and variance of the mean over the first axis."""
    return replicates.mean(axis=0), replicates.var(axis=0, ddof=1) / len(replicates)


def _contribution(mean: Array, variance: Array, axes: tuple[int, ...]) -> Array:
    """Return the size of one contribution over ``axes`` of the cells; 0 where all are unlit."""
    present = tuple(axis for axis in axes if axis < mean.ndim)
    light, spread = (a.sum(axis=present, keepdims=True) for a in (mean, variance))
    return np.asarray(np.divide(spread, light, out=np.zeros_like(light), where=light > 0))
