"""Both previews of shipped scenes and of random sensors, by facets, against photons or level 2.

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
from render.preview.converged import Effort, transport_at
from render.progress import Clock
from render.reference import render_transport
from render.scene import load_scene
from tests.oracles.kept_photons import analog
from tests.oracles.random_scenes import random_scene

BOUND = 0.05
"""Median over facets of how far the shader's preview may be off."""
CONVERGED_BOUND = 0.02
"""The same of the converged one."""
QUICK = Effort(photons=60_000, paths=8192, arrivals=4_000_000)


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


def agreements(name: str, samples: int, effort: Effort) -> tuple[Agreement, Agreement]:
    """Compare the shader's preview and the converged one.

    ``samples`` are photons per lamp, or of a render per cell.
    """
    number = name.removeprefix("random-")
    scene = load_scene(name) if number == name else random_scene(int(number))
    flat = np.zeros(1)
    phi = baseline_design(scene).phi
    with Preview(scene) as preview:
        light = preview.transport(phi[:, None], flat)[0].sum(axis=(0, 1)).ravel()
    assert (phi == np.pi / 2).all()
    lamps = transport_at(scene, 0.0, np.array([np.pi / 2]), effort, Clock(1, None)).cells
    converged = lamps[:, 0, :, :-1].sum(axis=0).ravel()
    began = time.perf_counter()
    if scene.diffuser is None:
        pad = analog(scene, pressed=True, bend=0.0)
        batches = sum(pad.cells(lamp, at, samples).replicates for lamp, at in enumerate(phi))
        truth, se = batches.mean(axis=0).ravel(), stats.sem(batches, axis=0).ravel()
    else:
        rendered = render_transport(scene, phi[:, None], flat, samples=samples)
        truth = rendered.T.sum(axis=(0, 1)).ravel()
        se = np.sqrt((rendered.se**2).sum(axis=(0, 1))).ravel()
    seconds = time.perf_counter() - began
    print(f"{name}: {light.size} facets, truth in {seconds:.0f} s", flush=True)
    noise = float(np.median(se / truth))
    followed = _agreement("converged", converged, truth, noise)
    return _agreement("shader", light, truth, noise), followed


def _agreement(level: str, light: np.ndarray, truth: np.ndarray, noise: float) -> Agreement:
    off = np.abs(light / truth - 1)
    found = Agreement(
        off=float(np.median(off)),
        p95=float(np.percentile(off, 95)),
        ratio=float(light.sum() / truth.sum()),
        noise=noise,
    )
    print(
        f"{level:10s} off by {found.off:.1%} (median), {found.p95:.1%} (95 %); "
        f"ratio of sums {found.ratio:.3f}; noise {found.noise:.1%}",
        flush=True,
    )
    return found


@pytest.mark.parametrize(
    ("name", "samples"),
    [
        ("finger24", 60),
        ("gelsight-mini", 500_000),
        ("digit", 1_000_000),
        ("random-19", 300_000),
        ("digit-dome", 250_000),
    ],
)
def test_the_previews_are_near_the_truth(name: str, samples: int) -> None:
    shader, converged = agreements(name, samples, QUICK)
    assert shader.off < np.hypot(BOUND, shader.noise)
    assert converged.off < np.hypot(CONVERGED_BOUND, converged.noise)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("scene")
    parser.add_argument("--samples", type=int, default=1000)
    asked = parser.parse_args()
    agreements(asked.scene, asked.samples, Effort())
