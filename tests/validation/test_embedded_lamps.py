"""Previews of lamps cast into the silicone against analog photons, lamp by lamp and together.

Level 2 is held against the same photons in ``tests.validation.test_clear_pads``.

From the command line, with full effort:
``python -m tests.validation.test_embedded_lamps [--arrivals N] [CASE ...]``.
"""

from __future__ import annotations

import numpy as np
import pytest

from render.preview import Preview
from render.preview.converged import Effort, can_converge, transport_at
from render.progress import Clock
from tests.long import LONG
from tests.oracles.kept_photons import PHI, photons_kept
from tests.oracles.pads import CASES, scene_of_case
from tests.validation.deviations import (
    Deviation,
    assert_converged_is_near,
    deviations_of_lamps,
    print_deviations,
)

ARRIVALS = 6_000_000 if LONG else 1_000_000
WHOLE = tuple(case for case in CASES if "cast in" in case)
FAST = ("cast in", "cast into a rim rough 0.1")
DRAWN_BOUND = 0.1
"""Median over facets of how far the preview as drawn may be off."""


def deviations(case: str, arrivals: int) -> dict[str, list[Deviation]]:
    """Return, of the converged preview and the shader's, those of facets.

    Of each lamp alone, and last of all of them together.
    """
    scene, phi = scene_of_case(case), np.array([PHI])
    (bend,) = scene.bending.angles
    effort = Effort(photons=60_000, paths=8192, arrivals=arrivals)
    with Preview(scene) as preview:
        cells = {"as drawn": preview.transport(phi, np.array([bend]))[0][:, 0, 0]}
    if can_converge(scene):
        found = transport_at(scene, bend, phi, effort, Clock(1, None)).cells
        cells["converged"] = found[:, 0, :, :-1]
    truth, lamps = photons_kept(case, pressed=True), range(scene.lamp_count)
    levels = {name: [level[lamp] for lamp in lamps] for name, level in cells.items()}
    return deviations_of_lamps(levels, [truth[:, lamp] for lamp in lamps])


@pytest.mark.parametrize("case", WHOLE if LONG else FAST)
def test_previews_are_near_the_light_of_lamps_in_the_silicone(case: str) -> None:
    told = deviations(case, ARRIVALS)
    drawn = told["as drawn"][-1]
    assert drawn.median < drawn.noise + DRAWN_BOUND
    if "converged" in told:
        assert_converged_is_near(told["converged"])


if __name__ == "__main__":
    print_deviations(WHOLE, deviations, ARRIVALS)
