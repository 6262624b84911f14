"""The previews of pads with a diffuser on some edges against photons, lamp by lamp.

Level 2 is held against them in ``test_clear_pads``. From the command line:
``python -m tests.validation.test_diffuser_edges [--converged] [CASE ...]``.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats

from render.arrays import Array
from render.preview import Preview
from render.preview.converged.transport import Effort, task_count, transport_at
from render.progress import Clock
from render.scene import Scene
from tests.oracles.kept_photons import PHI, photons_kept
from tests.oracles.pads import CASES, scene_of_case

EFFORT = Effort(photons=100_000, paths=8192, arrivals=6_000_000)
BOUND = 0.06
"""Median over sites of a lamp's light; pads with a diffuser on three edges are off by 0.05."""


class Agreement(NamedTuple):
    """Of one lamp: medians of ``|level / truth - 1|`` and of the truth's noise, ratio of sums."""

    off: float
    noise: float
    ratio: float


def shader_cells(scene: Scene) -> tuple[Array, Array]:
    """Return facets ``(lamp, site, facet)`` and sites ``(lamp, site)`` as the shader draws them."""
    with Preview(scene) as preview:
        facets, sites = preview.transport(np.array([PHI]), np.array(scene.bending.angles))
    return facets[:, 0, 0], sites[:, 0, 0]


def converged_cells(scene: Scene) -> tuple[Array, Array]:
    """Return the same of the converged preview."""
    clock = Clock(task_count(scene, EFFORT), None)
    cells = transport_at(scene, scene.bending.angles[0], np.array([PHI]), EFFORT, clock).cells[:, 0]
    return cells[..., :-1], cells[..., -1]


def agreement(cells: Array, photons: Array) -> Agreement:
    """Hold ``cells`` ``(target...)`` of a lamp against its photons ``(batch, target)``."""
    light, truth = cells.ravel(), photons.mean(axis=0)
    return Agreement(
        float(np.median(np.abs(light / truth - 1))),
        float(np.median(stats.sem(photons) / truth)),
        float(light.sum() / truth.sum()),
    )


@pytest.mark.parametrize(
    "case", ["rim on left and right rough 0.1", "rim on tip and base, painted"]
)
def test_the_preview_of_every_lamp_is_near_the_truth(case: str) -> None:
    scene = scene_of_case(case)
    _, sites = shader_cells(scene)
    photons = photons_kept(case, pressed=False)
    for lamp in range(scene.lamp_count):
        found = agreement(sites[lamp], photons[:, lamp])
        assert found.off < np.hypot(BOUND, found.noise)


def main() -> None:
    """Compare the cases that are named, or all with a diffuser on edges that they name."""
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", nargs="*", metavar="CASE")
    parser.add_argument("--converged", action="store_true")
    asked = parser.parse_args()
    for case in asked.cases or [name for name in CASES if "rim on" in name]:
        scene = scene_of_case(case)
        levels = {"preview": shader_cells(scene)}
        if asked.converged:
            levels["converged"] = converged_cells(scene)
        truth = photons_kept(case, pressed=True), photons_kept(case, pressed=False)
        for lamp, placed in enumerate(scene.placed_lamps()):
            for number, kind in enumerate(("facets", "sites")):
                for level, cells in levels.items():
                    found = agreement(cells[number][lamp], truth[number][:, lamp])
                    print(
                        f"{case:34s} {placed.edge or 'listed':6s} {kind:6s} {level:9s} "
                        f"off by {found.off:.1%} (median), ratio of sums {found.ratio:.3f}, "
                        f"noise {found.noise:.1%}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
