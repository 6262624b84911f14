"""Eqs. (4.6) and (4.7) for many lightings at once: the compiled twin of ``render.metric``.

A *block* holds one lighting per lane, lanes last, so that one instruction treats 8 or 16 of them.
The dtype follows the arguments: float32 for exhaustive searches, float64 elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba.cpython.unsafe.tuple import tuple_setitem
from numpy.typing import NDArray

from render.compiled import compiled
from render.metric import MetricConfig

Single = NDArray[np.float32]
Double = NDArray[np.float64]
Indices = NDArray[np.int64]
set_item: Any = tuple_setitem
F = TypeVar("F", bound=Callable[..., Any])

# Contraction and reciprocals may round differently; NaN and infinity keep their meaning.
_FASTMATH = {"contract", "arcp", "nsz"}


def vectorized(function: F) -> F:
    """Compile ``function`` so that its loops over lanes may use wide instructions."""
    return compiled(function, error_model="numpy", fastmath=_FASTMATH)


def kernel_constants(config: MetricConfig, lam: float, dtype: Any) -> np.ndarray:
    """Return what the kernel needs to know of the conventions: ``(count_max, lam, ddof, ring)``."""
    return np.array([config.count_max, lam, config.ddof, float(config.cyclic)], dtype=dtype)


def channel_mark(channels: int, dtype: Any) -> tuple[Any, ...]:
    """Return a zero of ``dtype`` per channel: the compiler unrolls its loops by their number."""
    return (dtype(0),) * channels


@vectorized
def score_lanes(
    base: np.ndarray,
    block: np.ndarray,
    bends: int,
    constants: np.ndarray,
    mark: tuple[Any, ...],
    out: np.ndarray,
) -> None:
    """Write S of ``clip(base + block)`` to ``out`` ``(lane,)``.

    ``base`` ``(bend * site, facet, channel)`` is common to all lanes, ``block``
    ``(bend * site, facet, channel, lane)``, both in counts and of the dtype of ``constants``;
    ``mark`` is that of the channels, see `channel_mark`: values of one lane stay in registers.
    """
    cells, facets, lanes = block.shape[0], block.shape[1], out.shape[0]
    dtype = constants.dtype
    zero, one = dtype.type(0), dtype.type(1)
    high, lam, ddof = constants[0], constants[1], constants[2]
    ring = constants[3] > zero
    first_step = 0 if ring else 1
    norm_share = one / dtype.type(facets)
    step_share = one / dtype.type(facets - first_step)
    norm_freedom = one / (dtype.type(facets) - ddof)
    step_freedom = one / (dtype.type(facets - first_step) - ddof)
    norm = np.empty((facets, lanes), dtype)
    step = np.empty((facets, lanes), dtype)
    hue = np.empty((len(mark), lanes), dtype)
    first_hue = np.empty((len(mark), lanes), dtype)
    mean = np.empty((2, lanes), dtype)
    square = np.empty((2, lanes), dtype)
    metric = np.empty((cells, lanes), dtype)
    hue[:] = zero
    for cell in range(cells):
        mean[:] = zero
        square[:] = zero
        for facet in range(facets):
            here = mark
            for channel in range(len(mark)):
                here = set_item(here, channel, base[cell, facet, channel])
            for lane in range(lanes):
                total, distance, seen = zero, zero, mark
                for channel in range(len(mark)):
                    # Comparisons that are false for NaN keep it, as in render.metric.
                    value = here[channel] + block[cell, facet, channel, lane]
                    value = zero if value < zero else (high if value > high else value)
                    seen = set_item(seen, channel, value)
                    total += value * value
                length = np.sqrt(total)
                scale = one / (length if length > zero else one)
                norm[facet, lane] = length
                mean[0, lane] += length
                for channel in range(len(mark)):
                    seen = set_item(seen, channel, seen[channel] * scale)
                    change = seen[channel] - hue[channel, lane]
                    distance += change * change
                for channel in range(len(mark)):
                    hue[channel, lane] = seen[channel]
                distance = np.sqrt(distance)
                step[facet, lane] = distance
                mean[1, lane] += distance
            if facet == 0:
                # The step into facet 0 comes from the last one, which is not known yet.
                mean[1] = zero
                first_hue[:] = hue
        for lane in range(lanes):
            if ring:
                distance = zero
                for channel in range(len(mark)):
                    change = first_hue[channel, lane] - hue[channel, lane]
                    distance += change * change
                distance = np.sqrt(distance)
                step[0, lane] = distance
                mean[1, lane] += distance
            mean[0, lane] *= norm_share
            mean[1, lane] *= step_share
        for facet in range(facets):
            for lane in range(lanes):
                deviation = norm[facet, lane] - mean[0, lane]
                square[0, lane] += deviation * deviation
        for facet in range(first_step, facets):
            for lane in range(lanes):
                deviation = step[facet, lane] - mean[1, lane]
                square[1, lane] += deviation * deviation
        for lane in range(lanes):
            intensity = mean[0, lane] - np.sqrt(square[0, lane] * norm_freedom)
            color = mean[1, lane] - np.sqrt(square[1, lane] * step_freedom)
            metric[cell, lane] = intensity + lam * color
    _score_map(metric, bends, ddof, out)


@vectorized
def _score_map(metric: np.ndarray, bends: int, ddof: Any, out: np.ndarray) -> None:
    """Write S of eq. (4.7) of ``metric`` ``(bend * site, lane)`` to ``out`` ``(lane,)``."""
    cells, lanes = metric.shape
    sites = cells // bends
    one = metric.dtype.type(1)
    by_bend = np.zeros((bends, lanes), metric.dtype)
    by_site = np.zeros((sites, lanes), metric.dtype)
    total = np.zeros(lanes, metric.dtype)
    for bend in range(bends):
        for site in range(sites):
            for lane in range(lanes):
                value = metric[bend * sites + site, lane]
                by_bend[bend, lane] += value
                by_site[site, lane] += value
                total[lane] += value
    spread = np.zeros((2, lanes), metric.dtype)
    for lane in range(lanes):
        total[lane] /= metric.dtype.type(cells)
    for bend in range(bends):
        for lane in range(lanes):
            deviation = by_bend[bend, lane] / metric.dtype.type(sites) - total[lane]
            spread[0, lane] += deviation * deviation
    for site in range(sites):
        for lane in range(lanes):
            deviation = by_site[site, lane] / metric.dtype.type(bends) - total[lane]
            spread[1, lane] += deviation * deviation
    bend_freedom = one / (metric.dtype.type(bends) - ddof)
    site_freedom = one / (metric.dtype.type(sites) - ddof)
    for lane in range(lanes):
        out[lane] = total[lane] - (
            np.sqrt(spread[0, lane] * bend_freedom) + np.sqrt(spread[1, lane] * site_freedom)
        )


@vectorized
def best_of_tile(
    prefix: Single,
    middles: Single,
    blocks: Single,
    suffixes: int,
    bends: int,
    constants: Single,
    mark: tuple[Any, ...],
    threshold: np.float32,
    free: Indices,
    middle_used: Indices,
    suffix_used: Indices,
    scores: Single,
    codes: Indices,
) -> int:
    """Keep the best ``len(scores)`` assignments above ``threshold``; return how many there are.

    ``free`` ``(rule,)`` is what they may still weigh; middles and suffixes weigh so much.
    """
    keep, lanes = len(scores), blocks.shape[-1]
    out = np.empty(lanes, np.float32)
    count, worst = 0, 0
    for block in range(len(blocks)):
        first = block * lanes
        valid = min(lanes, suffixes - first)
        for middle in range(len(middles)):
            unused = free - middle_used[middle]
            if (unused < 0).any():
                continue
            score_lanes(prefix + middles[middle], blocks[block], bends, constants, mark, out)
            for lane in range(valid):
                if out[lane] > threshold and (suffix_used[first + lane] <= unused).all():
                    place = worst
                    if count < keep:
                        place = count
                        count += 1
                    scores[place] = out[lane]
                    codes[place] = middle * suffixes + first + lane
                    if count == keep:
                        worst = int(np.argmin(scores))
                        threshold = max(threshold, scores[worst])
    return count


@vectorized
def score_moves(
    counts: Double,
    change: Double,
    pairs: Indices,
    bends: int,
    constants: Double,
    mark: tuple[Any, ...],
    lanes: int,
) -> Double:
    """Return S of ``counts`` ``(B * S, K, channel)`` after each pair of changes ``(.., move)``."""
    cells, facets = counts.shape[0], counts.shape[1]
    scores = np.empty(len(pairs))
    block = np.zeros((cells, facets, len(mark), lanes))
    out = np.empty(lanes)
    for start in range(0, len(pairs), lanes):
        valid = min(lanes, len(pairs) - start)
        for cell in range(cells):
            for facet in range(facets):
                for channel in range(len(mark)):
                    row = change[cell, facet, channel]
                    for lane in range(valid):
                        first, second = pairs[start + lane, 0], pairs[start + lane, 1]
                        block[cell, facet, channel, lane] = row[first] + row[second]
        score_lanes(counts, block, bends, constants, mark, out)
        scores[start : start + valid] = out[:valid]
    return scores
