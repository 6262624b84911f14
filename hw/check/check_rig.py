"""One check of a rig: from its photographs to a diagnosis, against the model or its record."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hw.calibrated_powers import CalibratedPowers
from hw.camera.photo_set import PhotoSet
from hw.camera.self_test import check_order
from hw.check.bands import find_bands
from hw.check.camera_response import measured_response
from hw.check.commission import RigRecord
from hw.check.diagnosis import Diagnosis
from hw.check.image_check import check_image
from hw.check.orientation import check_orientation
from hw.check.prediction import PadPrediction, SiteSpots
from hw.check.rig_tolerances import RigTolerances, rig_tolerances
from hw.check.sweep_check import check_sweep
from hw.errors import CaptureError
from render.arrays import Array
from render.scene import Palette, Scene


@dataclass(frozen=True, eq=False)
class RigCheck:
    """What a check found: a diagnosis, and the colors that it rests on.

    Arguments:
        diagnosis: of the rig.
        prediction: with the camera's response as it was found.
        colors: ``(fiber, site, channel)`` of a sweep, ``(site, channel)`` of one photograph.
    """

    diagnosis: Diagnosis
    prediction: PadPrediction
    colors: Array


@dataclass(frozen=True, eq=False)
class KnownHealth:
    """What is known of a rig when it was well: its record, or calibrated powers, or neither."""

    record: RigRecord | None = None
    powers: CalibratedPowers | None = None

    def ratio(self, prediction: PadPrediction) -> Array | None:
        """Return measured over predicted light ``(fiber, site[, channel])``; None if unknown."""
        if self.record is not None:
            return self.record.ratio
        if self.powers is None:
            return None
        return np.broadcast_to(self.powers.power[:, None], prediction.cells)

    def tolerances(self, sweep: bool, noise: Array) -> RigTolerances:
        """Return what a healthy rig may differ by; ``noise`` ``(site, channel)`` is in counts."""
        starts = 0 if self.record is None else self.record.starts
        known = rig_tolerances(sweep=sweep, starts=starts, noise=noise)
        if self.record is None and self.powers is not None:
            return known.with_powers(self.powers.error)
        # The record of a healthy rig holds its powers already.
        return known


def check_rig(
    scene: Scene,
    prediction: PadPrediction,
    photos: PhotoSet,
    spots: SiteSpots,
    noise: Array,
    known: KnownHealth,
) -> RigCheck:
    """Return what photographs say of a rig.

    Arguments:
        scene: of the design that the rig shows.
        prediction: the model's.
        photos: a sweep, or one photograph of all fibers.
        spots: where sites are in them.
        noise: standard deviation of a site's color in counts, ``(site, channel)``.
        known: of the rig when it was well.

    Raises:
        CaptureError: the photographs cannot be used: turned, mirrored, channels swapped, dark.
    """
    tolerances = known.tolerances(bool(photos.alone), noise)
    ratio = known.ratio(prediction)
    if known.record is not None:
        prediction = replace(prediction, response=known.record.response)
    if photos.alone:
        colors = photos.stacked(prediction.lit, spots.colors)
        lit = np.flatnonzero(prediction.lit)
        alone = np.stack([photos.alone[fiber] for fiber in lit.tolist()])
        check_orientation(prediction.alone[lit], alone, spots)
        check_order(prediction.alone.sum(axis=1), colors.sum(axis=1), scene.palette)
        if known.record is None:
            prediction = replace(prediction, response=measured_response(prediction, colors))
        diagnosis = check_sweep(prediction, colors, tolerances, ratio)
    else:
        assert photos.together is not None
        _check_one(prediction, photos.together, spots, scene.palette)
        colors = spots.colors(photos.together)
        diagnosis = check_image(prediction, colors, tolerances, ratio)
    bands = find_bands(scene, prediction.power, photos, spots.pad)
    return RigCheck(replace(diagnosis, bands=tuple(bands)), prediction, colors)


def _check_one(prediction: PadPrediction, photo: Array, spots: SiteSpots, palette: Palette) -> None:
    """Refuse one photograph of all fibers that is turned, or whose channels are swapped.

    Where left is red and right is blue both look alike, so both are named.
    """
    problems = []
    for check in (
        partial(check_order, prediction.together, spots.colors(photo), palette),
        partial(check_orientation, prediction.together[None], photo[None], spots),
    ):
        try:
            check()
        except CaptureError as error:
            problems.append(error)
    if problems:
        raise CaptureError("; or ".join(map(str, problems)), field=problems[0].field)
