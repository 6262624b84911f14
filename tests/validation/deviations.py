"""How far cells of one level are from those of analog photons."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

MEDIAN_OF_NORMAL = 0.6745
"""Median of the absolute value, in standard deviations."""


class Deviation(NamedTuple):
    """Of cells from the photons': ratio of sums and its error, |cell / truth - 1|, its noise."""

    ratio: float
    error: float
    median: float
    p95: float
    noise: float


def deviation(cells: np.ndarray, truth: np.ndarray) -> Deviation:
    """Return that of ``(cell,)`` from ``(batch, cell)`` of photons."""
    mean, se = truth.mean(axis=0), stats.sem(truth, axis=0)
    known = np.isfinite(mean) & (mean > 0.0)
    off = np.abs(cells[known] / mean[known] - 1.0)
    whole = truth[:, known].sum(axis=1)
    return Deviation(
        float(cells[known].sum() / whole.mean()),
        float(stats.sem(whole) / whole.mean()),
        float(np.median(off)),
        float(np.quantile(off, 0.95)),
        float(MEDIAN_OF_NORMAL * np.median(se[known] / mean[known])),
    )


def deviations_of_lamps(
    levels: Mapping[str, Sequence[np.ndarray]], truth: Sequence[np.ndarray]
) -> dict[str, list[Deviation]]:
    """Return, of each level, those of every lamp alone, and last of all of them together.

    ``levels`` have an array of cells for each lamp, ``truth`` ``(batch, cell)`` of photons.
    """
    told = {}
    for name, lamps in levels.items():
        rows = [cells.ravel() for cells in lamps]
        told[name] = [
            deviation(row, rep)
            for row, rep in zip([*rows, sum(rows)], [*truth, sum(truth)], strict=True)
        ]
    return told


def assert_converged_is_near(told: Sequence[Deviation]) -> None:
    """Hold lamps alone, and the last, all together, to the bounds of the converged preview."""
    *lamps, together = told
    assert abs(together.ratio - 1.0) < 3.0 * together.error + 0.02
    assert together.median < together.noise + 0.05
    for lamp in lamps:
        assert abs(lamp.ratio - 1.0) < 3.5 * lamp.error + 0.04


def print_deviations(
    cases: Sequence[str],
    of_case: Callable[[str, int], dict[str, list[Deviation]]],
    arrivals: int,
) -> None:
    """Print the deviations of the cases that the command line names, or of all."""
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(cases))
    parser.add_argument("--arrivals", type=int, default=arrivals)
    chosen = parser.parse_args()
    for case in chosen.cases or cases:
        for name, rows in of_case(case, chosen.arrivals).items():
            for number, row in enumerate(rows):
                which = "all" if number == len(rows) - 1 else f"lamp {number}"
                print(
                    f"{case:34s} {name:9s} {which:6s} ratio {row.ratio:.3f} +- {row.error:.3f}, "
                    f"off by {row.median:.1%} (95 %: {row.p95:.1%}), noise {row.noise:.1%}",
                    flush=True,
                )
