"""Both previews of pads of all kinds against analog photons, lamp by lamp and together.

Level 2 is held against the same photons in ``tests.validation.test_clear_pads``.

From the command line: ``python -m tests.validation.test_pad_previews [--arrivals N] [CASE ...]``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest

from render.preview import Preview
from render.preview.converged import Effort, transport_at
from render.progress import Clock
from tests.long import LONG
from tests.oracles.kept_photons import PHI, WHOLE, photons_kept
from tests.oracles.pads import scene_of_case
from tests.validation.deviations import Deviation, deviation

ARRIVALS = 6_000_000 if LONG else 2_000_000
DRAWN, CONVERGED = "as drawn", "converged"
FAST = (
    "white, mirror and black walls", "white walls rough 0.1", "mirrors all round, lit from below",
    "cast in", "cast into a rim rough 0.1", "rim on left and right rough 0.1",
    "rim on tip and base, painted", "window lit at its edges rough 0.05", "dome",
)  # fmt: skip
DRAWN_WELL = tuple(case for case in FAST if "window" not in case)
"""What the preview as drawn leaves out matters little there."""
KNOWN = (
    "narrow", "narrow 3 deg", "narrow 6 deg", "narrow rough 0.03", "narrow, clear rim",
    "thin rim narrow", "far small lamp rough 0.01", "no face", "wide no face",
    "sharp lobe no face", "mixed 6", "random 0", "random 7", "random 9", "random 13", "random 20",
    "random 21",
)  # fmt: skip
"""Where converged light is known to be off by more (RESULTS.md): narrow beams, in air, and
lamps that light facets over the whole pad."""


class Told(NamedTuple):
    """What a level says of the facets, or sites, of a pad: of each lamp, and of all together."""

    level: str
    target: str
    lamps: list[Deviation]
    together: Deviation


def deviations(case: str, arrivals: int) -> Iterator[Told]:
    """Yield those of both previews, of facets and of sites."""
    scene, phi = scene_of_case(case), np.array([PHI])
    bend = scene.bending.angles[0]
    effort = Effort(photons=60_000, paths=8192, arrivals=arrivals)
    with Preview(scene) as preview:
        drawn = [each[:, 0, 0] for each in preview.transport(phi, np.array([bend]))]
    followed = transport_at(scene, bend, phi, effort, Clock(1, None)).cells[:, 0]
    for level, facets, sites in (
        (DRAWN, *drawn),
        (CONVERGED, followed[..., :-1], followed[..., -1]),
    ):
        for target, cells in (("facets", facets), ("sites", sites)):
            light = cells.reshape(scene.lamp_count, -1)
            truth = photons_kept(case, pressed=target == "facets")
            # A lamp may light nothing at all.
            lit = [lamp for lamp in range(scene.lamp_count) if np.nansum(truth[:, lamp]) > 0.0]
            lamps = [deviation(light[lamp], truth[:, lamp]) for lamp in lit]
            yield Told(level, target, lamps, deviation(light.sum(axis=0), truth.sum(axis=1)))


@pytest.mark.parametrize("case", WHOLE if LONG else FAST)
def test_previews_have_the_light_of_analog_photons(case: str) -> None:
    whole, cell, single = (0.06, 0.12, 0.15) if case in KNOWN else (0.02, 0.03, 0.04)
    for level, target, lamps, together in deviations(case, ARRIVALS):
        if level == CONVERGED:
            assert abs(together.ratio - 1.0) < 3.0 * together.error + whole
            assert together.median < together.noise + cell
            for lamp in lamps:
                assert abs(lamp.ratio - 1.0) < 3.5 * lamp.error + single
        elif case in DRAWN_WELL:
            assert together.median < np.hypot(0.05, together.noise)
            if target == "sites" and "rim on" in case:
                for lamp in lamps:
                    assert lamp.median < np.hypot(0.06, lamp.noise)


def main() -> None:
    """Print what both levels say of the cases that are named, or of all."""
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(WHOLE))
    parser.add_argument("--arrivals", type=int, default=ARRIVALS)
    chosen = parser.parse_args()
    for case in chosen.cases or WHOLE:
        for level, target, lamps, together in deviations(case, chosen.arrivals):
            worst = max(lamps, key=lambda lamp: abs(lamp.ratio - 1.0))
            print(
                f"{case:38s} {target:6s} {level:9s} ratio {together.ratio:.3f} +- "
                f"{together.error:.3f} (worst lamp {worst.ratio:.3f} +- {worst.error:.3f}), off by "
                f"{together.median:.1%} (95 %: {together.p95:.1%}), noise {together.noise:.1%}",
                flush=True,
            )


if __name__ == "__main__":
    main()
