"""Stated 95 % intervals hold: how often they cover a much longer run, over many cells.

Intervals come from a run's own independent replicates by Student's t. They are held against the
mean of all other runs, whose error (1 / sqrt(runs - 1) of theirs) costs well below 1 % of coverage.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy import stats

from render.reference import render_transport
from render.reference.error_bars import standard_error
from render.scene import load_scene
from tests.validation.film import LONG, ours
from tests.validation.rooms import ball, glass, milk, room
from tests.validation.test_extremes_cells import edited

REPLICATES = 8
RUNS = 48 if LONG else 10
FEW: dict[str, dict[str, int]] = {
    "bdpt": {}, "pssmlt": {"chains": 2048, "luminance_samples": 16384, "chains_only": True},
}  # fmt: skip


def coverage(runs: np.ndarray, errors: np.ndarray | None = None) -> float:
    """Return how often the 95 % interval of one run covers the mean of the others.

    ``runs`` has axes ``(run, replicate, ...)``; ``errors`` ``(run, ...)`` are the standard errors
    that the runs state (default: from the spread of their replicates). Cells that are NaN are
    left out.
    """
    count, replicates = runs.shape[:2]
    means = runs.mean(axis=1)
    if errors is None:
        errors = runs.std(axis=1, ddof=1) / np.sqrt(replicates)
    half = stats.t.ppf(0.975, replicates - 1) * errors
    others = (means.sum(axis=0) - means) / (count - 1)
    return float((np.abs(means - others) <= half)[np.isfinite(means)].mean())


def test_the_measure_itself_finds_95_percent_for_normal_numbers() -> None:
    numbers = np.random.Generator(np.random.PCG64(1)).normal(size=(RUNS, REPLICATES, 4000))
    assert coverage(numbers) == pytest.approx(0.945, abs=0.01)


def fog(mi: ModuleType, size: int) -> Any:
    """Fog without a boundary, lit by two lamps and a point."""
    return room(mi, point=True, size=size, fog=ball(-0.3, {"type": "null"}, milk(mi, 1.0, -0.4)))


def caustics(mi: ModuleType, size: int) -> Any:
    """The same beside milk in rough glass, whose caustics are rare and bright."""
    return room(
        mi, point=True, size=size, milk=ball(0.8, glass(0.3), milk(mi)),
        fog=ball(-0.8, {"type": "null"}, milk(mi, 1.0, -0.4)),
    )  # fmt: skip


# Few samples of rare and bright light are skewed, and Student's t is for normal numbers: pixels
# with error bars of 10 % (pssmlt, 512 samples, 2048 chains) were covered 88.9 % of the time.
CASES = [("bdpt", fog, 256)]
if LONG:
    CASES += [("pssmlt", fog, 512), ("bdpt", caustics, 4096), ("pssmlt", caustics, 4096)]


@pytest.mark.parametrize(("kind", "scenery", "spp"), CASES)
def test_intervals_of_pixels_cover_a_longer_run(
    mono: ModuleType, kind: str, scenery: Callable[[ModuleType, int], Any], spp: int
) -> None:
    scene = scenery(mono, 16 if LONG else 8)
    images = [
        ours(mono, scene, kind, spp, seed=s, replicates=REPLICATES, **FEW[kind])
        for s in range(RUNS)
    ]
    runs = np.stack([image.reshape(REPLICATES, -1) for image in images])
    found = coverage(runs)
    error = np.median(runs.std(axis=(0, 1)) / runs.mean(axis=(0, 1))) / np.sqrt(REPLICATES)
    print(
        f"{kind}, {scenery.__name__}, {RUNS} runs of {runs.shape[-1]} pixels at {error:.1%}: "
        f"covered {found:.1%}"
    )
    assert 0.90 <= found <= 0.99


@pytest.mark.parametrize(
    ("samples", "count"), [(100 if LONG else 50, 48), (800, 48 if LONG else 12)]
)
def test_intervals_of_transport_cells_cover_a_longer_run(
    tmp_path: Path, samples: int, count: int
) -> None:
    # Facets of a site share their samples, so runs count for more than cells do.
    scene = load_scene("finger20") if LONG else edited(tmp_path)
    # Groups of lanes are as independent as seeds are, and many at once cost less.
    estimate = render_transport(
        scene, np.array([0.5, np.pi / 2]), np.array([0.0]), samples=samples * count,
        replicates=REPLICATES * count,
    )  # fmt: skip
    runs = estimate.replicates.reshape(count, REPLICATES, *estimate.T.shape)
    found = coverage(runs, np.array([standard_error(run) for run in runs]))
    means = runs.mean(axis=1)
    error = np.nanmedian(means.std(axis=0, ddof=1) / estimate.T)
    print(
        f"transport, {samples} samples, {count} runs of {estimate.T.size} cells at {error:.1%}:"
        f" covered {found:.1%}, {coverage(runs):.1%} by their own spreads"
    )
    assert 0.90 <= found <= 0.99
