"""The sensing metric M (thesis eq. 4.6) and the design score S (eq. 4.7), for numpy and torch.

Every function takes numpy arrays or torch tensors of float32 or float64 and returns the same kind
and dtype. Only operations that both libraries share are used, so that one text serves searches,
training (the derivatives are finite everywhere) and the exported ONNX graph. NaN propagates:
clipping is written with ``where``, because the Clip operator of some runtimes swallows NaN.

Axes: fiber F, bend B, site S, facet K, color channel C (3 of most cameras, but any number here);
``...`` are any batch axes.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Literal

import numpy as np

from render.errors import TableError


@dataclass(frozen=True)
class MetricConfig:
    """Every convention that the thesis leaves open or implies; the defaults are its choices.

    Arguments:
        count_max: largest count of the camera; brighter facets are clipped to it.
        ddof: 0 divides variances by n (population), 1 by n - 1.
        cyclic: whether the last facet and the first one are neighbors.
        exposure_counts, exposure_percentile: exposure is set once per scene, so that this
            percentile of the baseline design's counts at bend 0 has this value.
    """

    count_max: float = 255.0
    ddof: Literal[0, 1] = 0
    cyclic: bool = True
    exposure_counts: float = 230.0
    exposure_percentile: float = 99.5


THESIS = MetricConfig()
MIN_HUE = 1e-9
"""Mean M_phi of a baseline; what is below is the rounding of lights that have one hue."""
DARK_COUNTS = 1.0
"""A facet of less in all channels is dark."""
LEAST_RADIANCE = 1e-12
"""Radiance of the skin, 1/(mm^2 sr) per unit power, below which a design is dark: of all light that
a lamp sends, a billionth falls on a skin of 300 mm^2."""
RETIRED = {"color_distance": "euclidean", "zero_colour": "zero"}
"""Conventions that files of earlier versions name, each with the only value that it ever had."""


def current_conventions(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a `MetricConfig` in ``stored``, without conventions that are retired."""
    return {k: v for k, v in stored.items() if k not in RETIRED or v != RETIRED[k]}


@dataclass(frozen=True)
class Score:
    """S of eq. (4.7) and its parts, each ``(...)`` in counts: S = mean - (sites + bends)."""

    score: Any
    mean: Any
    spread_sites: Any
    spread_bends: Any


def image_counts(transport: Any, power: Any, exposure: Any, config: MetricConfig = THESIS) -> Any:
    """Return the camera's counts ``(..., B, S, K, C)``: light adds up, is exposed, then clips.

    ``counts = min(max(exposure * sum_f power_f T_f, 0), count_max)`` (thesis 4.3.1), with
    ``transport`` ``(..., F, B, S, K[, C])`` and ``power`` ``(..., F, C)`` with the same leading
    axes.
    """
    return clip_counts(exposure * superposed(transport, power), config)


def superposed(transport: Any, power: Any) -> Any:
    """Return ``sum_f power_f T_f``, the radiance ``(..., B, S, K, C)`` of all fibers together.

    ``transport`` is ``(..., F, B, S, K)``, or ``(..., F, B, S, K, C)`` where materials depend on
    the channel, and ``power`` ``(..., F, C)``; both have the same leading axes.
    """
    tinted = "c" if transport.ndim - power.ndim == 3 else ""
    xp = _namespace(transport)
    return xp.einsum(f"...fbsk{tinted},...fc->...bskc", transport, power)


def clip_counts(counts: Any, config: MetricConfig = THESIS) -> Any:
    """Return ``counts`` (any shape) limited to ``[0, count_max]``; NaN stays NaN."""
    xp = _namespace(counts)
    counts = xp.where(counts < 0.0, 0.0, counts)
    return xp.where(counts > config.count_max, config.count_max, counts)


def clipped_fraction(counts: Any, config: MetricConfig = THESIS) -> Any:
    """Return the fraction ``(...)`` of facets of ``counts`` ``(..., B, S, K, C)`` that clip.

    A facet counts as clipped when any of its channels has reached ``count_max``.
    """
    xp = _namespace(counts)
    full = xp.amax(counts, -1) >= config.count_max
    fraction = xp.where(full, xp.ones_like(counts[..., 0]), xp.zeros_like(counts[..., 0]))
    return fraction.mean((-3, -2, -1))


def metric_terms(counts: Any, config: MetricConfig = THESIS) -> tuple[Any, Any]:
    """Return M_theta and M_phi, each ``(...)``, of ``counts`` ``(..., K, C)`` (eq. 4.6).

    ``M_theta = mean_i |c_i| - std_i |c_i|`` and
    ``M_phi = mean_i d(c_hat_i, c_hat_i+1) - std_i d(c_hat_i, c_hat_i+1)``.
    """
    brightness, step = facet_differences(counts, config)
    return _mean_minus_std(brightness, config), _mean_minus_std(_polar(step)[0], config)


def facet_differences(counts: Any, config: MetricConfig = THESIS) -> tuple[Any, Any]:
    """Return what both terms of eq. (4.6) are made of, of ``counts`` ``(..., K, C)``.

    They are ``|c_i|`` ``(..., K)`` and ``c_hat_i+1 - c_hat_i`` ``(..., K, C)``, of one facet less
    where the last is no neighbor of the first.
    """
    xp = _namespace(counts)
    norm, direction = _polar(counts)
    if config.cyclic:
        return norm, xp.roll(direction, -1, -2) - direction
    return norm, direction[..., 1:, :] - direction[..., :-1, :]


def site_metric(counts: Any, lam: Any, config: MetricConfig = THESIS) -> Any:
    """Return ``M = M_theta + lam M_phi``, ``(...)``, of ``counts`` ``(..., K, C)`` (eq. 4.6)."""
    intensity, hue = metric_terms(counts, config)
    return intensity + lam * hue


def pairwise_metric(counts: Any, config: MetricConfig = THESIS) -> Any:
    """Return the slow first metric, ``(...)``, over all facet pairs of ``(..., K, C)`` (eq. 4.5).

    ``M = mean_{i != j} d(c_i, c_j) - std_{i != j} d(c_i, c_j)``.
    """
    first, second = zip(*itertools.combinations(range(counts.shape[-2]), 2), strict=True)
    difference = counts[..., list(first), :] - counts[..., list(second), :]
    return _mean_minus_std(_polar(difference)[0], config)


def design_score(metric: Any, config: MetricConfig = THESIS) -> Score:
    """Return S and its parts of ``metric`` ``(..., B, S)`` (eq. 4.7).

    ``S = mean_{p,b} M - (std_p(mean_b M) + std_b(mean_p M))``.
    """
    mean = metric.mean((-2, -1))
    sites = _std(metric.mean(-2), config)
    bends = _std(metric.mean(-1), config)
    return Score(mean - (sites + bends), mean, sites, bends)


def score_terms(counts: np.ndarray, lam: float, config: MetricConfig = THESIS) -> np.ndarray:
    """Return the six terms that S of eq. (4.7) is the sum of, of ``counts`` ``(B, S, K, C)``.

    The means over states and sites of ``mean_i |c_i|``, ``-std_i |c_i|``, ``lam mean_i d`` and
    ``-lam std_i d`` of eq. (4.6), then less the spreads of M over sites and over bends. Noise moves
    each of them one way.
    """
    brightness, step = facet_differences(counts, config)
    steps = _polar(step)[0]
    score = design_score(
        _mean_minus_std(brightness, config) + lam * _mean_minus_std(steps, config), config
    )
    return np.array(
        [
            brightness.mean(),
            -_std(brightness, config).mean(),
            lam * steps.mean(),
            -lam * _std(steps, config).mean(),
            -score.spread_sites,
            -score.spread_bends,
        ]
    )


def choose_exposure(
    baseline_radiance: np.ndarray, bend0_index: int = 0, config: MetricConfig = THESIS
) -> float:
    """Return the scene's exposure in counts per unit of ``baseline_radiance`` ``(B, S, K, C)``.

    It puts the 99.5th percentile (over sites, facets and channels) of the baseline design at
    bend 0 at 230 counts.

    Raises:
        TableError: when that percentile is not a number of at least `LEAST_RADIANCE`.
    """
    level = float(np.percentile(baseline_radiance[bend0_index], config.exposure_percentile))
    if not (np.isfinite(level) and level >= LEAST_RADIANCE):
        raise TableError(
            f"the baseline design's brightest facets have radiance {level:g} 1/(mm^2 sr) per unit "
            f"power, allowed: finite and at least {LEAST_RADIANCE:g}; check that the lamps light "
            "the sites: tactilux describe says which hardly do",
            field="exposure",
        )
    return config.exposure_counts / level


def choose_lambda(counts: np.ndarray, config: MetricConfig = THESIS) -> float:
    """Return the weight of M_phi that makes both terms of eq. (4.6) weigh equally.

    ``lam = mean_{p,b} M_theta / mean_{p,b} M_phi`` for the baseline's ``counts``
    ``(B, S, K, C)``.

    Raises:
        TableError: when either mean is not a positive number, so that no weight does it.
    """
    intensity, hue = (float(term.mean()) for term in metric_terms(counts, config))
    if not (np.isfinite(intensity) and np.isfinite(hue) and intensity > 0.0 and hue > MIN_HUE):
        dark = float(np.mean(counts.max(axis=-1) < DARK_COUNTS))
        advice = (
            "give the sides of the baseline different colors, or lamps of one side, as in "
            '[baseline] left = ["red", "blue"]'
        )
        if dark > 0.5:
            advice = (
                f"{dark:.0%} of its facets have less than {DARK_COUNTS:g} count: widen the beams "
                "of the lamps, or aim them at the sites (tactilux describe says which hardly do)"
            )
        raise TableError(
            f"the baseline design has mean M_theta = {intensity:g} and M_phi = {hue:g}, allowed: "
            f"both above 0; {advice}",
            field="lam",
        )
    return intensity / hue


def _namespace(array: Any) -> ModuleType:
    """Return the library of ``array``; torch is never imported for numpy's sake."""
    if isinstance(array, np.ndarray | np.generic):
        return np
    import torch

    return torch


def _polar(vectors: Any) -> tuple[Any, Any]:
    """Return length ``(...)`` and direction ``(..., C)`` of ``(..., C)``; null stays null.

    Scaled by the largest component, so that float32 neither under- nor overflows, and safe at 0
    for derivatives.
    """
    xp = _namespace(vectors)
    largest = xp.amax(xp.abs(vectors), -1)
    dark = largest == 0.0
    scale = xp.where(dark, 1.0, largest)
    unit = vectors / scale[..., None]
    square = (unit * unit).sum(-1)
    length = xp.sqrt(xp.where(dark, 1.0, square))
    return xp.where(dark, 0.0, scale * length), unit / length[..., None]


def _std(values: Any, config: MetricConfig) -> Any:
    """Return the standard deviation over the last axis, two passes, with derivative 0 at 0."""
    xp = _namespace(values)
    if values.shape[-1] <= config.ddof:
        raise TableError(
            f"a spread over {values.shape[-1]} values with ddof = {config.ddof} is undefined, "
            "allowed: more values than ddof; use ddof = 0",
            field="ddof",
        )
    deviation = values - values.mean(-1)[..., None]
    variance = (deviation * deviation).sum(-1) / (values.shape[-1] - config.ddof)
    flat = variance == 0.0
    root = xp.sqrt(xp.where(flat, 1.0, variance))
    return xp.where(flat, 0.0, root)


def _mean_minus_std(values: Any, config: MetricConfig) -> Any:
    return values.mean(-1) - _std(values, config)
