"""What renders of one material know better than the model of all materials.

At the reference lines, the mean of the smooth ratio (``hw.smooth_ratio``) corrects the model; draws
from what it leaves open say how wrong the corrected model may still be. Near the rendered material
the model is then the reference itself; only its change with the material is the preview's ("space
mapping": Bandler et al. 1994).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hw.calibration.reference_lines import ReferenceLines, frame_positions
from hw.pad_light import PadLight
from hw.smooth_ratio import Ratios, SmoothRatio, pooled, ratios
from render.bending import Array

DRAWS = 200


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
        cell = self.light.cell_of(position)
        return ratios(frame_positions(), cell, radiance, error, self.log_light[bend, fiber])


@dataclass(frozen=True, eq=False)
class RenderedCorrection:
    """Rendered over modelled light at the reference lines.

    Arguments:
        log_ratio: ``(bend, fiber, point)``; 0 where nothing was rendered.
        draws: ``(draw, bend, fiber, point)`` log errors that it may still have.
        noise: ``(bend,)`` rms of these draws, each fiber's constant taken out.
    """

    log_ratio: Array
    draws: Array
    noise: Array


def rendered_correction(renders: Sequence[Render], lines: ReferenceLines) -> RenderedCorrection:
    """Return the correction that ``renders`` of nearly one material ask for.

    Arguments:
        renders: at least one; light of the fibers that matter at each bend.
        lines: of the scene.
    """
    shape = renders[0].log_light.shape
    log_ratio, draws, noise = np.zeros(shape), np.zeros((DRAWS, *shape)), np.zeros(shape[0])
    rng = np.random.default_rng(5)
    place = frame_positions()
    for bend in range(len(noise)):
        data, wanted, lit = [], [], []
        for fiber, position in enumerate(lines.position):
            told = pooled([one.ratios(bend, fiber, position) for one in renders])
            if len(told.log_ratio):
                lit.append(fiber)
                data.append(told)
                wanted.append(np.isfinite(renders[0].log_light[bend, fiber]))
        if not lit:
            continue
        smooth = SmoothRatio(data)
        places = [place[on] for on in wanted]
        mean, spread = smooth.mean(places), smooth.spread(places)
        root = np.linalg.cholesky(spread + 1e-10 * np.eye(len(spread)))
        several = rng.standard_normal((DRAWS, len(mean))) @ root.T
        edges = np.cumsum([0, *(on.sum() for on in wanted)])
        square = 0.0
        for index, (fiber, on) in enumerate(zip(lit, wanted, strict=True)):
            own = several[:, edges[index] : edges[index + 1]]
            log_ratio[bend, fiber, on] = mean[edges[index] : edges[index + 1]]
            draws[:, bend, fiber, on] = own
            square += float(((own - own.mean(axis=1, keepdims=True)) ** 2).mean()) / len(lit)
        noise[bend] = np.sqrt(square)
    return RenderedCorrection(log_ratio, draws, noise)
