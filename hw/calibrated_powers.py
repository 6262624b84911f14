"""The powers of a rig's fibers as `tactilux hw calibrate` found them, for the commands after it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hw.errors import CalibrationError
from render.arrays import Array
from render.files import parse_json, read_text

FILE = "calibration.json"
UNKNOWN_ERROR = 0.08
"""Relative standard deviation of a power that was not calibrated."""


@dataclass(frozen=True, eq=False)
class CalibratedPowers:
    """Relative powers.

    Arguments:
        path: where they are from.
        power: ``(fiber,)`` of a fiber's light over the others', mean 1; 1 for fibers that were not
            photographed.
        error: ``(fiber,)`` its standard error.
    """

    path: Path
    power: Array
    error: Array

    def evened(self, drive: Array) -> Array:
        """Return the drive with which the fibers shine as ``drive`` ``(fiber, color)`` says.

        None is driven harder: all are dimmed to the weakest that is lit.
        """
        lit: NDArray[np.bool_] = np.any(drive, axis=1)
        weakest = self.power[lit].min(initial=np.inf)
        return np.where(lit[:, None], drive * (weakest / self.power)[:, None], 0.0)


def calibrated_powers(
    given: Path | None, beside: Path | None, scene_hash: str, fibers: int
) -> CalibratedPowers | None:
    """Return the powers in ``given``, or in ``calibration.json`` where it lies ``beside`` a file.

    A file that was not named counts only if it is of the same rig.

    ``beside`` is the scene or the design, where it is a file; ``scene_hash`` and ``fibers`` are
    those of the scene that the design is for, before or after calibration.

    Raises:
        CalibrationError: ``given`` is no calibration, or that of another rig.
    """
    path = given or (beside.parent / FILE if beside is not None else None)
    if path is None or (given is None and not path.is_file()):
        return None
    try:
        return _load(path, scene_hash, fibers)
    except CalibrationError:
        if given is not None:
            raise
        return None


def _load(path: Path, scene_hash: str, fibers: int) -> CalibratedPowers:
    try:
        content = parse_json(read_text(path))
        hashes = set(content["scene_hash"].values())
        power, error = (np.array(content[key], dtype=float) for key in ("power", "power_error"))
        good = power.shape == error.shape and power.ndim == 1 and not (power <= 0).any()
    except (ValueError, OverflowError, KeyError, TypeError, AttributeError):
        good = False
    if not good:
        raise CalibrationError(
            f"{path} is not a {FILE}: give the one that `tactilux hw calibrate` wrote",
            field="calibration",
        )
    if scene_hash not in hashes or len(power) != fibers:
        raise CalibrationError(
            f"{path} is the calibration of another scene (hash {', '.join(sorted(hashes))}), "
            f"allowed: of {scene_hash}; calibrate this rig",
            field="calibration",
        )
    # The file holds half-widths of 95 % intervals.
    error = error / (1.96 * power)
    return CalibratedPowers(path, np.nan_to_num(power, nan=1.0),
                            np.nan_to_num(error, nan=UNKNOWN_ERROR))  # fmt: skip
