"""Reconstruction errors of two designs side by side, over common normals and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optimize.design import Array
from optimize.reconstruction.reconstruct import CameraNoise, reconstruct
from optimize.scoring import student_factor
from render.scene.schema import Scene


@dataclass(frozen=True)
class Compared:
    """An error of both designs in degrees, with the 95 % interval of their paired difference."""

    baseline: float
    design: float
    difference: float
    interval: tuple[float, float]

    def to_json(self) -> dict[str, object]:
        """Return plain data."""
        return {**vars(self), "interval": list(self.interval)}


def compare_reconstruction(
    scene: Scene,
    known: Sequence[tuple[Array, Array]],
    shown: Sequence[tuple[Array, Array]],
    noise: CameraNoise,
    seeds: Sequence[int],
) -> dict[str, Compared]:
    """Return mean and 95th percentile of the errors of both readers, by name.

    Arguments:
        scene: the sensor.
        known: colors of baseline and design that readers learn from, see `reconstruct`.
        shown: colors that the camera sees.
        noise: of the camera.
        seeds: independent draws of normals and noise, common to both designs.
    """
    rows: dict[str, list[list[float]]] = {}
    for seed in seeds:
        both = [
            reconstruct(scene, learned, true, noise, seed)
            for learned, true in zip(known, shown, strict=True)
        ]
        for reader in ("lookup", "regressor"):
            errors = [getattr(one, reader) for one in both]
            rows.setdefault(f"{reader}_mean", []).append([float(e.mean()) for e in errors])
            rows.setdefault(f"{reader}_95%", []).append(
                [float(np.quantile(e, 0.95)) for e in errors]
            )
    found = {}
    for name, values in rows.items():
        table = np.array(values)
        gain = table[:, 1] - table[:, 0]
        reach = student_factor(len(gain)) * float(gain.std(ddof=1)) / len(gain) ** 0.5
        middle = float(gain.mean())
        first, second = (float(column.mean()) for column in table.T)
        found[name] = Compared(first, second, middle, (middle - reach, middle + reach))
    return found
