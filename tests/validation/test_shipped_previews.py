"""The preview of each shipped scene and of random sensors, by facets, against photons or level 2.

Analog photons where there is no diffuser, else renders; all lamps at full power in the directions
of the baseline, on the flat pad.

From the command line, one scene with more of them:
``python -m tests.validation.test_shipped_previews SCENE [--samples N]``; ``random-4`` is the fourth
of ``tests.oracles.random_scenes``.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
import pytest
from scipy import stats

from optimize.design import baseline_design
from render.preview import Preview
from render.reference import render_transport
from render.scene import load_scene
from tests.oracles.analog_cells import AnalogScene
from tests.oracles.random_scenes import random_scene

BOUND = 0.05
"""Median over facets of how far the preview may be off."""


@dataclass(frozen=True)
class Agreement:
    """Preview over the truth, of what each facet gets from all lamps together.

    Arguments:
        off: median of ``|preview / truth - 1|`` over facets, noise included.
        p95: its 95th percentile.
        ratio: of the sums over all facets.
        noise: median relative standard error of the truth of a facet.
    """

    off: float
    p95: float
    ratio: float
    noise: float


def agreement(name: str, samples: int) -> Agreement:
    """Compare; ``samples`` are photons per lamp, or of a render per cell."""
    number = name.removeprefix("random-")
    scene = load_scene(name) if number == name else random_scene(int(number))
    flat = np.zeros(1)
    phi = baseline_design(scene).phi
    with Preview(scene) as preview:
        light = preview.transport(phi[:, None], flat)[0].sum(axis=(0, 1)).ravel()
    began = time.perf_counter()
    if scene.diffuser is None:
        pad = AnalogScene(scene, True)
        batches = sum(pad.cells(lamp, at, samples).replicates for lamp, at in enumerate(phi))
        truth, se = batches.mean(axis=0).ravel(), stats.sem(batches, axis=0).ravel()
    else:
        rendered = render_transport(scene, phi[:, None], flat, samples=samples)
        truth = rendered.T.sum(axis=(0, 1)).ravel()
        se = np.sqrt((rendered.se**2).sum(axis=(0, 1))).ravel()
    seconds = time.perf_counter() - began
    off = np.abs(light / truth - 1)
    found = Agreement(
        off=float(np.median(off)),
        p95=float(np.percentile(off, 95)),
        ratio=float(light.sum() / truth.sum()),
        noise=float(np.median(se / truth)),
    )
    print(
        f"{name:14s} facets {off.size:4d}: off by {found.off:.1%} (median), {found.p95:.1%} "
        f"(95 %); ratio of sums {found.ratio:.3f}; noise {found.noise:.1%}; {seconds:.0f} s",
        flush=True,
    )
    return found


@pytest.mark.parametrize(
    ("name", "samples"),
    [("finger24", 60), ("gelsight-mini", 500_000), ("digit", 1_000_000), ("random-19", 300_000)],
)
def test_the_preview_is_near_the_truth(name: str, samples: int) -> None:
    found = agreement(name, samples)
    assert found.off < np.hypot(BOUND, found.noise)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("scene")
    parser.add_argument("--samples", type=int, default=1000)
    asked = parser.parse_args()
    agreement(asked.scene, asked.samples)
