"""What cells cost for all lamps at once and lamp by lamp, on pads of ``tests.oracles.pads``.

``python -m tests.benchmarks.lamps_together CASE [CASE ...]`` prints, for facets and for untouched
sites, the squared relative error times seconds of two cores: the median over cells (``table``) and
over colors with all lamps lit (``colors``), the sum over all cells, and how many times more it
costs lamp by lamp.
"""

from __future__ import annotations

import argparse
import time
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np

from render.reference.llvm import VARIANT
from tests.oracles.pads import CASES, scene_of_case

PHI = 1.2
REPLICATES = 16
CORES = 2
RUNS = {"monte-carlo": (256, 6), "pssmlt": (8192, 4)}
"""Lanes and passes: together, and lamp by lamp (of which Markov chains are made)."""


class Cost(NamedTuple):
    """Costs in seconds, and the sum over all cells with its standard error."""

    table: float
    colors: float
    total: float
    error: float


def cost(cells: Any, fibers: int, lanes: int, passes: int) -> Cost:
    """Return what ``cells`` cost by plain Monte Carlo, without compiling them."""
    from render.sampling.monte_carlo import MonteCarlo

    MonteCarlo(cells, lanes, REPLICATES, 2).sample(1)
    run = MonteCarlo(cells, lanes, REPLICATES, 3)
    began = time.process_time()
    run.sample(passes)
    seconds = (time.process_time() - began) / CORES
    found = run.estimate()
    sums = found.sum(axis=(1, 2))
    colors = found.reshape(REPLICATES, fibers, -1).sum(axis=1)
    table, lit = (_median(values.reshape(REPLICATES, -1)) * seconds for values in (found, colors))
    return Cost(table, lit, float(sums.mean()), float(sums.std(ddof=1) / REPLICATES**0.5))


def _median(values: np.ndarray) -> float:
    mean, variance = values.mean(axis=0), values.var(axis=0, ddof=1) / len(values)
    return float(np.median(variance[mean > 0] / mean[mean > 0] ** 2))


def main() -> None:
    """Measure the cases that are named."""
    mi.set_variant(VARIANT)
    from render.reference import pad_cells

    parser = argparse.ArgumentParser()
    parser.add_argument("cases", nargs="+", metavar="CASE", help=", ".join(CASES))
    for case in parser.parse_args().cases:
        scene = scene_of_case(case)
        phi = np.full((scene.lamp_count, 1), PHI)
        for indented in (True, False):
            together, apart = (
                cost(
                    pad_cells(scene, phi, 0.0, indented, sampler=sampler),  # type: ignore[arg-type]
                    scene.lamp_count,
                    *shape,
                )
                for sampler, shape in RUNS.items()
            )
            print(
                f"{case:24s} {'facets' if indented else 'sites':6s} "
                f"table {together.table:.2e} ({apart.table / together.table:.1f} times more) "
                f"colors {together.colors:.2e} ({apart.colors / together.colors:.1f}) "
                f"sums {together.total:.4e} +- {together.error:.1e}, "
                f"{apart.total:.4e} +- {apart.error:.1e}",
                flush=True,
            )


if __name__ == "__main__":
    main()
