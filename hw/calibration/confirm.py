"""Confirming a calibration with the reference renderer: renders of the calibrated scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hw.calibration.fit import Calibration
from hw.photo_set import PhotoSet
from hw.site_colours import SiteSpots
from render.bending import Array
from render.progress import Progress
from render.scene import Scene


@dataclass(frozen=True)
class Confirmation:
    """Photographs against PSSMLT renders at the sites, relative.

    Arguments:
        rms: of photographs over renders less 1, powers and gains as calibrated.
        noise: what the renders' own error bars explain of it.
        before: the same rms for the scene before calibration, gain fitted.
        mutations: per cell.
        seconds: of rendering.
    """

    rms: float
    noise: float
    before: float
    mutations: int
    seconds: float


def confirm(
    scene: Scene,
    calibrated: Scene,
    found: Calibration,
    sets: list[PhotoSet],
    phi: Array,
    bends: Array,
    *,
    mutations: int,
    progress: Callable[[Progress], None] | None = None,
) -> Confirmation:
    """Render both scenes and compare them with the photographs.

    Arguments:
        scene: before calibration.
        calibrated: after it.
        found: powers and gains.
        sets: the photographs at each bend.
        phi: ``(fiber,)`` rad.
        bends: ``(bend,)`` rad.
        mutations: per cell.
        progress: called by the renderer.
    """
    from render.reference import render_transport

    seen = []
    for index, bend in enumerate(bends):
        spots = SiteSpots(scene, float(bend))
        for fiber, photo in sets[index].alone.items():
            colours = spots.colours(photo) / (found.gain * found.power[fiber])
            seen.append((index, fiber, np.nanmean(colours, axis=1)))
    results = []
    for one in (calibrated, scene):
        estimate = render_transport(
            one, phi[:, None], bends, mutations=mutations, seeds=(11,), progress=progress
        )
        light, error = estimate.background[:, 0], estimate.background_se[:, 0]
        ratio = np.stack([values / light[fiber, bend] for bend, fiber, values in seen])
        noise = np.stack([(error / light)[fiber, bend] for bend, fiber, _ in seen])
        results.append((ratio / np.median(ratio), noise, estimate.seconds))
    (after, noise, first), (before, _, second) = results
    return Confirmation(
        rms=_rms(after - 1),
        noise=_rms(noise),
        before=_rms(before - 1),
        mutations=mutations,
        seconds=first + second,
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
