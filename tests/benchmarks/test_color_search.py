"""How long the searches take on a table of finger20's size, as a share of what is allowed.

Rates count processor seconds, so that a busy machine does not blur them. Seconds are printed as a
share of the bound and never asserted.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

from optimize.design import Design
from optimize.scoring import TableScorer
from optimize.search import alternating_search
from optimize.search.colors import exact_colors
from optimize.search.colors.colorings import color_units
from optimize.search.colors.enumeration import Enumeration
from render.chebyshev import chebyshev_nodes
from render.transport import TransportTable

CORES = 2


def wavy_table(fibers: int) -> TransportTable:
    rng = np.random.default_rng(0)
    phi = chebyshev_nodes(13, 0.0, np.pi)
    peak = rng.uniform(0.5, 2.5, (fibers, 1, 3, 15, 10))
    height = 0.3 * rng.lognormal(0.0, 0.5, (fibers, 1, 1, 15, 10))
    transport = height * np.exp(np.cos(phi[:, None, None, None] - peak) - 1.0)
    return TransportTable(transport, 0.01 * transport, phi, 400.0 / fibers, 100.0)


def report(capsys: pytest.CaptureFixture[str], what: str, seconds: float, allowed: float) -> None:
    with capsys.disabled():
        print(f"\n{what}: {seconds:.3g} s, {seconds / allowed:.2f} of the allowed {allowed:g} s")


def test_all_colors_of_20_fibers(capsys: pytest.CaptureFixture[str]) -> None:
    scorer = TableScorer(wavy_table(20))
    units = color_units(scorer, scorer.at_node(6))
    search = Enumeration(units, 3, scorer.table.lam, scorer.config, symmetric=True)
    search.best(8, limit=1)
    start = time.process_time()
    done = search.best(8, limit=2_000_000).evaluated
    assert done >= 2_000_000
    seconds = (time.process_time() - start) / done * search.total / CORES
    report(capsys, f"exact search of 3^20 on {CORES} cores, from {done} of them", seconds, 600.0)


def test_all_colors_of_14_fibers(capsys: pytest.CaptureFixture[str]) -> None:
    scorer = TableScorer(wavy_table(14))
    warm = exact_colors(scorer, scorer.at_node(6))
    start = time.process_time()
    again = exact_colors(scorer, scorer.at_node(6))
    report(capsys, "exact search of 3^14, processor time", time.process_time() - start, 2.0)
    assert again.score == warm.score


def test_the_whole_search_of_20_fibers(capsys: pytest.CaptureFixture[str]) -> None:
    scorer = TableScorer(wavy_table(20))
    design = Design.of_colors(np.full(20, np.pi / 2), [0] * 8 + [2] * 4 + [1] * 8)
    edges = ["left"] * 8 + ["tip"] * 4 + ["right"] * 8
    start = time.perf_counter()
    found = alternating_search(scorer, design, edges=edges)
    report(capsys, "colors and directions together", time.perf_counter() - start, 20.0)
    assert found.score >= scorer.score(design.phi, design.power)
