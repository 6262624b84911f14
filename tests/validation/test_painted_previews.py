"""The preview of pads with black, white and metal edges, by facets and sites, against photons.

From the command line:
``python -m tests.validation.test_painted_previews [CASE ...]``.
"""

from __future__ import annotations

import argparse

import numpy as np
import pytest
from scipy import stats

from render.preview import Preview
from tests.oracles.kept_photons import PHI, photons_kept
from tests.oracles.pads import CASES, scene_of_case

BOUND = 0.05
"""Median over facets, and over sites, of how far the preview may be off."""
FAST = (
    "white, mirror and black walls",
    "white walls rough 0.1",
    "mirrors all round, lit from below",
)


def agreement(case: str) -> list[tuple[float, float]]:
    """Return medians of ``|preview / truth - 1|`` and of the truth's noise: of facets, of sites.

    All lamps together.
    """
    scene = scene_of_case(case)
    bend = scene.bending.angles[0]
    with Preview(scene) as preview:
        drawn = preview.transport(np.array([PHI]), np.array([bend]))
    found = []
    for name, cells in zip(("facets", "sites"), drawn, strict=True):
        batches = photons_kept(case, pressed=name == "facets").sum(axis=1)
        truth, noise = batches.mean(axis=0), stats.sem(batches, axis=0)
        light = cells.sum(axis=(0, 1, 2)).ravel()
        off = np.abs(light / truth - 1)
        found.append((float(np.median(off)), float(np.median(noise / truth))))
        print(
            f"{case:36s} {name:6s} off by {found[-1][0]:.1%} (median), "
            f"{np.percentile(off, 95):.1%} (95 %); ratio of sums {light.sum() / truth.sum():.3f}; "
            f"noise {found[-1][1]:.1%}",
            flush=True,
        )
    return found


@pytest.mark.parametrize("case", FAST)
def test_the_preview_of_painted_edges_is_near_the_truth(case: str) -> None:
    for off, noise in agreement(case):
        assert off < np.hypot(BOUND, noise)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", nargs="*", metavar="CASE")
    asked = parser.parse_args()
    for chosen in asked.cases or [name for name in CASES if "wall" in name or "mirror" in name]:
        agreement(chosen)
