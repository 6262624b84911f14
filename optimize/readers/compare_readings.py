"""Two designs held against each other in degrees, on common normals and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optimize.design import Array
from optimize.objectives import ReaderName
from optimize.readers.reading import Reading, half_width

JSON_NAMES: dict[ReaderName, str] = {"place": "lookup", "sensor": "regressor"}
"""How programs know the readers, in the order that they are told."""


@dataclass(frozen=True)
class ErrorComparison:
    """An error of both designs in degrees, with the 95 % interval of their paired difference."""

    baseline: float
    design: float
    difference: float
    interval: tuple[float, float]

    def to_json(self) -> dict[str, object]:
        """Return plain data."""
        return {**vars(self), "interval": list(self.interval)}


def compare_readings(baseline: Reading, design: Reading) -> dict[str, ErrorComparison]:
    """Return mean and 95th percentile of the errors of both readers, by name.

    Both were shown the same normals and noise: readings of the same seeds, at least two. What the
    colors of their models may be off by is in the interval where both readings know it.
    """
    comparisons = {}
    for reader, name in JSON_NAMES.items():
        for key, figure in (("mean", "means"), ("95%", "percentiles")):
            first, second = (getattr(getattr(one, reader), figure) for one in (baseline, design))
            gain = second - first
            half = half_width(gain, _moved(baseline, design, reader, figure))
            mean = float(gain.mean())
            comparisons[f"{name}_{key}"] = ErrorComparison(
                float(first.mean()), float(second.mean()), mean, (mean - half, mean + half)
            )
    return comparisons


def reads_better(baseline: Reading, design: Reading, reader: ReaderName) -> bool:
    """Return whether ``design`` is read better beyond the draws of normals and noise.

    That is what its model says; what the model may be off by is no reason to keep the baseline.
    """
    first, second = (getattr(one, reader).means for one in (baseline, design))
    gain = second - first
    return bool(gain.mean() + half_width(gain, np.empty(0)) < 0.0)


def _moved(baseline: Reading, design: Reading, reader: ReaderName, figure: str) -> Array:
    """Return by how much models' errors move the difference; a percentile moves like the mean."""
    first, second = (getattr(one, reader) for one in (baseline, design))
    if len(first.offsets) != len(second.offsets):
        return np.empty(0)
    moves = [
        one.offsets * (getattr(one, figure).mean() / one.mean if one.mean else 1.0)
        for one in (first, second)
    ]
    return np.asarray(moves[1] - moves[0])
