"""Errors on held-out designs: random lighting whose every cell was predicted out of fold.

Transport here has the axes ``(direction, fiber, bend, site, normal)`` of the training cells; a
design picks one direction and one color per fiber.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.metric import design_score, image_counts, site_metric
from render.scene import RGB, Palette
from render.transport import TransportTable


@dataclass(frozen=True)
class RandomDesigns:
    """Random lighting designs.

    ``direction`` ``(design, fiber)`` is an index, ``power`` ``(design, fiber, channel)`` one color
    per fiber at full power.
    """

    direction: np.ndarray
    power: Array

    def transport(self, cells: Array) -> Array:
        """Return ``(design, fiber, bend, site, normal)`` of transport per cell."""
        return np.asarray(cells[self.direction, np.arange(cells.shape[1])])


def random_designs(
    count: int,
    allowed: np.ndarray,
    block: np.ndarray,
    rng: np.random.Generator,
    palette: Palette = RGB,
) -> RandomDesigns:
    """Return ``count`` designs over the directions ``allowed`` ``(direction, fiber)``.

    A design stays within one ``block`` ``(direction,)``: a sensor is made of one material.
    Neighboring fibers share a color in runs of 1, 2 or 4, as the candidates of a search do;
    every third design has a run length of its own.
    """
    fibers = allowed.shape[1]
    inside = [allowed & (block == b)[:, None] for b in np.unique(block)]
    usable = [choices for choices in inside if choices.any(axis=0).all()]
    parts = np.array_split(np.arange(count), len(usable))
    drawn = [
        np.stack([rng.choice(np.flatnonzero(ok), size=len(part)) for ok in choices.T], axis=1)
        for choices, part in zip(usable, parts, strict=True)
    ]
    colors = random_colors(count, fibers, rng, len(palette.names))
    return RandomDesigns(np.concatenate(drawn), palette.matrix[colors])


def random_colors(
    count: int, fibers: int, rng: np.random.Generator, colors: int = 3
) -> NDArray[np.int64]:
    """Return ``(design, fiber)``: one of so many colors per fiber, in runs of 1, 2 or 4."""
    color = rng.integers(0, colors, size=(count, fibers))
    run = np.array([1, 2, 4])[np.arange(count) % 3]
    start = (np.arange(fibers) // run[:, None]) * run[:, None]
    return np.take_along_axis(color, start, axis=1)


@dataclass(frozen=True)
class ColorErrors:
    """Errors of predicted facet colors c and scores S against the reference.

    Arguments:
        facet_median, facet_p95: ``|c - c_reference| / |c_reference|``.
        facet_rms: root of ``sum |c - c_reference|^2 / sum |c_reference|^2``.
        facet_rms_true: the same without the reference's own noise, whose known variance is taken
            off both sums; 0 when the noise explains everything.
        score_median, score_p95: ``|S - S_reference|`` in counts.
        kendall_tau: rank agreement of the scores.
    """

    facet_median: float
    facet_p95: float
    facet_rms: float
    facet_rms_true: float
    score_median: float
    score_p95: float
    kendall_tau: float

    @classmethod
    def of(
        cls, counts: Array, scores: Array, truth: Array, noise: Array, true_scores: Array
    ) -> ColorErrors:
        """Return the errors of ``counts`` and ``scores``.

        Predicted ``counts`` and the ``truth`` with its standard error ``noise`` are ``(design,
        bend, site, facet, channel)``; both kinds of scores are ``(design,)``.
        """
        lit = np.linalg.norm(truth, axis=-1) > 0
        facet = np.linalg.norm(counts - truth, axis=-1)[lit] / np.linalg.norm(truth, axis=-1)[lit]
        off, light = ((counts - truth) ** 2).sum(), (truth**2).sum()
        random = (noise**2).sum()
        score = np.abs(scores - true_scores)
        true = max(off - random, 0.0) / max(light - random, 1e-12 * light)
        return ColorErrors(
            facet_median=float(np.quantile(facet, 0.5)),
            facet_p95=float(np.quantile(facet, 0.95)),
            facet_rms=float(np.sqrt(off / light)),
            facet_rms_true=float(np.sqrt(true)),
            score_median=float(np.quantile(score, 0.5)),
            score_p95=float(np.quantile(score, 0.95)),
            kendall_tau=kendall_tau(scores, true_scores),
        )


@dataclass(frozen=True)
class HeldOutErrors(ColorErrors):
    """Errors of one prediction against the reference.

    ``name`` is what predicted; ``cell_median`` and ``cell_p95`` are of ``|T / T_reference - 1|``
    of single cells.
    """

    name: str
    cell_median: float
    cell_p95: float


@dataclass(frozen=True)
class HeldOutEvaluation:
    """Held-out designs with the reference's answer.

    Arguments:
        reference, error: transport ``(direction, fiber, bend, site, normal)`` and its standard
            error; reliable: the same shape.
        designs: what is asked.
        exposure, lam: of the scene.
        held_out: ``(direction, fiber, bend)`` cells that were held out.
        bends: indices of the bends that colors and scores are compared at.
        copies: of every lamp (`surrogate.model.lamp_copies`), rendered by the same light paths.
    """

    reference: Array
    error: Array
    reliable: np.ndarray
    designs: RandomDesigns
    exposure: float
    lam: float
    held_out: np.ndarray
    bends: np.ndarray
    copies: int = 1

    def noise(self, rng: np.random.Generator) -> Array:
        """Return standard normal numbers for all cells; copies of a lamp share theirs."""
        directions, lamps, *rest = self.error.shape
        drawn = rng.standard_normal((directions, lamps // self.copies, *rest))
        return np.concatenate([drawn] * self.copies, axis=1) if self.copies > 1 else drawn

    def counts(self, transport: Array) -> Array:
        """Return the facets' counts ``(design, bend, site, facet, channel)``, clipped."""
        light = self.designs.transport(transport[:, :, self.bends, :, :-1])
        return np.asarray(image_counts(light, self.designs.power, self.exposure))

    def counts_noise(self) -> Array:
        """Return the standard error of the reference's counts, the shape of :meth:`counts`."""
        error = self.designs.transport(self.error[:, :, self.bends, :, :-1])
        variance = np.einsum("dfc,dfbsk->dbskc", self.designs.power**2, error**2, optimize=True)
        return np.asarray(self.exposure * np.sqrt(variance))

    def scores(self, counts: Array) -> Array:
        """Return S ``(design,)`` over the bends of ``counts``."""
        return np.asarray(design_score(site_metric(counts, self.lam)).score)

    def errors(self, name: str, transport: Array) -> HeldOutErrors:
        """Return the errors of ``transport`` against the reference.

        Those of single cells are of the reliable ones; of all that are lit where none is.
        """
        held_out = self.held_out[..., None, None]
        known = self.reliable & held_out
        if not known.any():
            known = (self.reference > 0) & held_out
        cell = np.abs(transport[known] / self.reference[known] - 1.0)
        truth, guess = self.counts(self.reference), self.counts(transport)
        colors = ColorErrors.of(
            guess, self.scores(guess), truth, self.counts_noise(), self.scores(truth)
        )
        return HeldOutErrors(
            **vars(colors),
            name=name,
            cell_median=float(np.quantile(cell, 0.5)),
            cell_p95=float(np.quantile(cell, 0.95)),
        )


def kendall_tau(a: Array, b: Array) -> float:
    """Return Kendall's tau-b of two lists of scores; 0 when one of them is constant.

    ``tau = (concordant - discordant) / sqrt((pairs - ties_a) (pairs - ties_b))``.
    """
    first = np.sign(a[:, None] - a[None])
    second = np.sign(b[:, None] - b[None])
    norm = np.sqrt((first**2).sum() * (second**2).sum())
    return float((first * second).sum() / norm) if norm > 0 else 0.0


def scene_bends(table: TransportTable, angles: tuple[float, ...]) -> np.ndarray:
    """Return the indices of the scene's bends in ``table``, or all where one is missing."""
    distance = np.abs(table.bends[None] - np.asarray(angles)[:, None])
    nearest = distance.argmin(axis=1)
    exact = distance[np.arange(len(angles)), nearest] < 1e-6
    return nearest if exact.all() else np.arange(len(table.bends))
