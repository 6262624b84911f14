"""What renders of one material know better than the model of all materials.

At the reference lines, the mean of the smooth ratio (``hw.smooth_ratio``) corrects the model; the
modes of what it leaves open say how wrong the corrected model may still be. Near the rendered
material the model is then the reference itself; only its change with the material is the preview's
("space mapping": Bandler et al. 1994).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hw.calibration.model_error import Modes, modes_of
from hw.calibration.reference_lines import ReferenceLines, frame_positions
from hw.pad_light import PadLight
from hw.smooth_ratio import Ratios, SmoothRatio, pooled, ratios
from render.bending import Array


@dataclass(frozen=True, eq=False)
class Render:
    """One material, rendered and modelled.

    Arguments:
        light: rendered.
        log_light: ``(bend, fiber, point)`` of the model at the reference lines, NaN where the
            camera sees nothing.
    """

    light: PadLight
    log_light: Array

    def ratios(self, bend: int, fiber: int, position: Array) -> Ratios:
        """Return what it says about one fiber at its line's points ``(point, 2)`` mm."""
        radiance, error = self.light.at(bend, fiber, position)
        part = self.light.part_of(position)
        return ratios(frame_positions(), part, radiance, error, self.log_light[bend, fiber])


@dataclass(frozen=True, eq=False)
class RenderedCorrection:
    """Rendered over modelled light at the reference lines.

    Arguments:
        log_ratio: ``(bend, fiber, point)``; 0 where nothing was rendered.
        modes: log errors that it may still have.
    """

    log_ratio: Array
    modes: Modes


def rendered_correction(renders: Sequence[Render], lines: ReferenceLines) -> RenderedCorrection:
    """Return the correction that ``renders`` of nearly one material ask for.

    Arguments:
        renders: at least one; light of the fibers that matter at each bend.
        lines: of the scene.
    """
    shape = renders[0].log_light.shape
    log_ratio, modes = np.zeros(shape), []
    place = frame_positions()
    for bend in range(shape[0]):
        data, wanted, lit = [], [], []
        for fiber, position in enumerate(lines.position):
            told = pooled([one.ratios(bend, fiber, position) for one in renders])
            if len(told.log_ratio):
                lit.append(fiber)
                data.append(told)
                wanted.append(np.isfinite(renders[0].log_light[bend, fiber]))
        if not lit:
            modes.append(np.zeros((0, *shape[1:])))
            continue
        smooth = SmoothRatio(data)
        places = [place[on] for on in wanted]
        mean, own = smooth.mean(places), modes_of(smooth.spread(places))
        edges = np.cumsum([0, *(on.sum() for on in wanted)])
        modes.append(np.zeros((len(own), *shape[1:])))
        for index, (fiber, on) in enumerate(zip(lit, wanted, strict=True)):
            log_ratio[bend, fiber, on] = mean[edges[index] : edges[index + 1]]
            modes[bend][:, fiber, on] = own[:, edges[index] : edges[index + 1]]
    return RenderedCorrection(log_ratio, tuple(modes))
