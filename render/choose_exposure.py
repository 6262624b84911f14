"""Exposure and lambda: the scale of a scene's scores, fixed by its preview alone.

Scores can only be compared on one scale, so the scale is a property of the scene. Two files of one
hash have the same, whatever was rendered of them and however noisily. It is taken from the preview,
which is free of noise; under a window of another index than the pad's, where that may
lack a third of the light, from a fixed number of traced paths. Where the preview is too bright or
too dark by a factor, renders of the baseline reach 230 counts divided or multiplied by it.
``tactilux train`` says how much they reach, and clipped facets are counted wherever scores are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.metric import (
    THESIS,
    MetricConfig,
    choose_exposure,
    choose_lambda,
    image_counts,
    superposed,
)
from render.scene import Scene


@dataclass(frozen=True)
class ScoreScale:
    """What turns transport into scores.

    Arguments:
        exposure: counts per 1/(mm^2 sr).
        lam: weight of M_phi in eq. (4.6).
    """

    exposure: float
    lam: float


def baseline_power(scene: Scene) -> Array:
    """Return the baseline's light ``(fiber, channel)``: one color per edge (thesis 5.1)."""
    palette = scene.palette
    lights = np.vstack([palette.matrix, np.zeros(len(palette.channels))])  # -1, the last, is off
    return lights[[palette.index(color) for color in scene.baseline_colors()]]


def scene_scale(scene: Scene, config: MetricConfig = THESIS) -> ScoreScale:
    """Return the scale of ``scene``: its baseline at full power, phi = pi/2, in the preview.

    The 99.5th percentile of its counts at the least bend is 230, and both terms of eq. (4.6) weigh
    equally over all bends. Where all LEDs look alike but for brightness, as to a camera of one
    channel, or where one lamp lights everything, hue says nothing and lambda is 0; so where they
    look alike in each of several shots and the baseline shines alike in all. Constraints,
    tolerances and free ranges change nothing, as they have no part in the hash.

    Raises:
        GraphicsError: no OpenGL library can draw the preview.
        TableError: the baseline is dark, or one color lights everything.
    """
    if scene.window_refracts:
        from render.preview.converged import few_paths_transport, phi_nodes

        # The middle one of the nodes is straight ahead.
        middle = len(phi_nodes(scene)) // 2
        transport = few_paths_transport(scene).cells[:, middle : middle + 1, ..., :-1]
    else:
        from render.preview import Preview

        with Preview(scene) as preview:
            ahead = np.array([math.pi / 2])
            transport, _ = preview.transport(ahead, np.array(scene.state_axis))
    bend0 = int(np.argmin(scene.state_axis))
    power = baseline_power(scene)
    alike = scene.palette.one_shot.one_hue and np.linalg.matrix_rank(power) == 1
    one_hue = bool(alike) or scene.lamp_count == 1
    return scale_of(transport[:, 0], power, bend0, config, one_hue=one_hue)


def scale_of(
    transport: Array,
    power: Array,
    bend0: int = 0,
    config: MetricConfig = THESIS,
    *,
    one_hue: bool = False,
) -> ScoreScale:
    """Return the scale at which the light of ``power`` ``(fiber, channel)`` has 230 counts.

    ``transport`` is ``(fiber, bend, site, facet[, channel])`` 1/(mm^2 sr), ``power`` the
    baseline's; counts at the bend or state ``bend0`` set the exposure. With ``one_hue``, hue says
    nothing and has no weight.
    """
    exposure = choose_exposure(superposed(transport, power), bend0, config)
    counts = np.asarray(image_counts(transport, power, exposure, config))
    return ScoreScale(exposure, 0.0 if one_hue else choose_lambda(counts, config))
