"""Previews of lamps cast into the silicone against analog photons, lamp by lamp and together.

Level 2 is held against the same photons in ``tests.validation.test_clear_pads``.

From the command line, with full effort:
``python -m tests.validation.test_embedded_lamps [--photons N] [--arrivals N] [CASE ...]``.
"""

from __future__ import annotations

import argparse

import numpy as np
import pytest

from render.preview import Preview
from render.preview.converged import Effort, can_converge, transport_at
from render.progress import Clock
from tests.long import LONG
from tests.oracles.analog_cells import AnalogScene
from tests.oracles.mesh_cells import BentScene
from tests.oracles.pads import CASES, scene_of_case
from tests.validation.deviations import Deviation, deviation

PHI = 1.2
PHOTONS, ARRIVALS = (2_000_000, 6_000_000) if LONG else (300_000, 1_000_000)
WHOLE = tuple(case for case in CASES if "cast in" in case)
FAST = ("cast in", "cast into a rim rough 0.1")
DRAWN_BOUND = 0.1
"""Median over facets of how far the preview as drawn may be off."""


def deviations(case: str, photons: int, arrivals: int) -> dict[str, list[Deviation]]:
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
    planes = not bend and scene.skin is scene.window is None
    pad = AnalogScene(scene) if planes else BentScene(scene, bend, True, 4000)
    lamps = range(scene.lamp_count)
    truth = [pad.cells(lamp, PHI, photons).replicates for lamp in lamps]
    told = {}
    for name, level in cells.items():
        rows = [level[lamp].ravel() for lamp in lamps]
        told[name] = [
            deviation(row, rep)
            for row, rep in zip([*rows, sum(rows)], [*truth, sum(truth)], strict=True)
        ]
    return told


@pytest.mark.parametrize("case", WHOLE if LONG else FAST)
def test_previews_are_near_the_light_of_lamps_in_the_silicone(case: str) -> None:
    told = deviations(case, PHOTONS, ARRIVALS)
    drawn = told["as drawn"][-1]
    assert drawn.median < drawn.noise + DRAWN_BOUND
    if "converged" in told:
        *lamps, together = told["converged"]
        assert abs(together.ratio - 1.0) < 3.0 * together.error + 0.02
        assert together.median < together.noise + 0.05
        for lamp in lamps:
            assert abs(lamp.ratio - 1.0) < 3.5 * lamp.error + 0.04


def main() -> None:
    """Print the deviations of the cases that are named, or of all."""
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(WHOLE))
    parser.add_argument("--photons", type=int, default=PHOTONS)
    parser.add_argument("--arrivals", type=int, default=ARRIVALS)
    chosen = parser.parse_args()
    for case in chosen.cases or WHOLE:
        for name, rows in deviations(case, chosen.photons, chosen.arrivals).items():
            for number, row in enumerate(rows):
                which = "all" if number == len(rows) - 1 else f"lamp {number}"
                print(
                    f"{case:34s} {name:9s} {which:6s} ratio {row.ratio:.3f} +- {row.error:.3f}, "
                    f"off by {row.median:.1%} (95 %: {row.p95:.1%}), noise {row.noise:.1%}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
