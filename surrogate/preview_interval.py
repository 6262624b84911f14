"""How far scores of a preview may be off: intervals that a scene's previews calibrate.

The preview as the shader draws it and those whose light was followed are made in ways that share
little. Where they are far apart, light goes ways that are hard to follow, and the followed ones are
less sure too. So the half-width of these for 90 % coverage is
``hypot(DIFFERENCE_SHARE D, floor M, HUE_SHARE n lam)``, with D the same quantile of the differences
to the drawn one's scores over random designs of the very scene, and M the mean metric of its
baseline. The floor is that of flat pads, of flat pads with a diffuser, whose light all previews
miss alike, or of pads that bend; n is the photon noise of the colors, which ``lam`` of eq. (4.6)
weighs: where a rough face blurs hues that differ little, it is some ten times M. The drawn preview
has a fraction of M alone.

The factors are split conformal over sensors (Vovk 2005; Lei et al. 2018), each sensor weighing the
same: those that held 90 % of the scores of random designs on sensors that analog photons were sent
through (``python -m tests.validation.test_preview_model``; tests/validation/RESULTS.md says on how
few sensors they rest). Their previews had photon noise of 1 to 15 % of a color.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from render.arrays import Array
from render.scene import Scene
from surrogate.training.evaluation import random_colors

COVERAGE = 0.9
DESIGNS = 100
"""Random designs that the two previews are compared on."""
DRAWN_FRACTION = 0.085
"""Half-width of the preview over the baseline's mean M."""
FLAT_FLOOR, DIFFUSER_FLOOR, BENT_FLOOR = 0.005, 0.012, 0.02
"""Half-width of a followed preview over M where it and the drawn one agree: of clear pads that do
not bend, of others with a diffuser, and of pads that bend, whose light both lose alike."""
DIFFERENCE_SHARE = 0.1
"""Half-width of a followed preview over D where they differ."""
HUE_SHARE = 0.08
"""Half-width over ``lam`` per photon noise of colors."""
BRIGHTNESS_SHARE = 0.7
"""The same over M where hue says nothing and ``lam`` is 0."""

Scores = Callable[[Array, Array], Array]
"""From phi ``(design, fiber)`` and power ``(design, fiber, channel)`` to S ``(design,)``."""


def drawn_half_width(mean: float) -> float:
    """Return the half-width of scores of the preview; ``mean`` is M of the baseline."""
    return DRAWN_FRACTION * mean


def followed_half_width(
    scene: Scene, mean: float, lam: float, difference: float, photon_noise: float
) -> float:
    """Return the half-width of scores of a preview of ``scene`` whose light was followed, counts.

    ``mean`` is M of its baseline and ``lam`` the weight of its hues, both in counts, ``difference``
    D of `preview_difference`, and ``photon_noise`` that of its colors, which counts by ``lam``, or
    by M where that is 0.
    """
    flat = FLAT_FLOOR if scene.diffuser is None else DIFFUSER_FLOOR
    floor = BENT_FLOOR if any(scene.bending.angles) else flat
    by_noise = HUE_SHARE * lam if lam > 0.0 else BRIGHTNESS_SHARE * mean
    return math.hypot(DIFFERENCE_SHARE * difference, floor * mean, by_noise * photon_noise)


def preview_difference(scene: Scene, drawn: Scores, followed: Scores) -> float:
    """Return D: the quantile `COVERAGE` of ``|S_drawn - S_followed|`` over random designs."""
    rng, lamps = np.random.default_rng(17), scene.lamp_count
    phi = rng.uniform(0.0, np.pi, (DESIGNS, lamps))
    palette = scene.palette
    power = palette.matrix[random_colors(DESIGNS, lamps, rng, len(palette.names))]
    return float(np.quantile(np.abs(drawn(phi, power) - followed(phi, power)), COVERAGE))
