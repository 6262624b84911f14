"""What ``pssmlt`` loses or wins against ``bdpt`` on pictures, at equal time.

Plain samples of ``pssmlt`` are the first ones of ``bdpt``, bit for bit, so one run is both:
``bdpt`` is its plain samples alone. Equal time = the ratio of the errors x the root of the ratio of
the times: what an error would be to the other one had both run as long. Above 1 ``pssmlt`` loses;
the product's bound is 1.15. Where chains count nothing, both pictures are one.

Errors are root mean squares over blocks of 8 x 8 pixels of the distance from a longer picture by
``bdpt`` of another seed, relative to it; blocks darker than a hundredth of the mean are left out.
Replicates would not do: of light that few of them have seen they state too little. The division of
the work and the errors are those of runs of two million samples, as if passes cost nothing besides
their samples; runs that do make pilots are 16 times as long and give short chains less of a chance
to be believed. Times are of passes as in such a long run, in processor seconds, with kernels from
the cache, plain samples and chains in turn.
"""

from __future__ import annotations

import time
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from render.integrators import mixed_run
from render.sampling.pssmlt import ChainSettings
from render.scene import load_scene
from tests.oracles.pads import scene_of_case
from tests.validation.test_slab_reference import lamp, slab

REPLICATES = 16
SEEDS, TRUTH_SEED = (2, 4, 5), 1
BLOCK = 8
SAMPLES = 1 << 21
TRUTH = 3
"""Times as many samples."""
LANES = 1 << 16
"""Of a short run, so that work is divided in small parts."""
TURNS = 6
BOUND = 1.15


def picture(name: str, mono: ModuleType, folder: Path) -> Any:
    """Return a lit scene whose picture is to be made."""
    from render.optics.lit_scene import lit_scene

    if name == "slab":
        return slab(mono, folder, lamp(mono))
    scene = load_scene("finger20") if name == "finger20" else scene_of_case("smooth")
    count = scene.lamp_count
    return lit_scene(
        scene, np.full(count, np.pi / 2), np.ones(count), 0.0, width=96, height=160
    )  # fmt: skip


def blocks(images: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return the means of blocks, of ``(replicate, pixel, channel)``."""
    image = images[..., 0].mean(axis=0)
    cut = image.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK)
    return np.asarray(cut.mean(axis=(1, 3)))


def run_of(sampler: Any, samples: int, seed: int) -> Any:
    """Return a run of ``pssmlt`` as by default."""
    settings = ChainSettings(chains=16384, p_large=0.6, replicates=REPLICATES, seed=seed)
    return mixed_run.MixedRun(sampler, settings, -(-samples // sampler.bins) * sampler.bins)


def pass_costs(sampler: Any) -> tuple[np.ndarray, float]:
    """Return what a pass of chains costs in plain samples, per turn, and what it counts."""
    run = run_of(sampler, mixed_run.PILOT_MIN, TRUTH_SEED)
    run.plain.sample(3)
    chains = run._started_chains()
    chains.sample(2)
    costs = []
    for _ in range(TURNS):
        began = time.process_time()
        run.plain.sample(1)
        between = time.process_time()
        chains.sample(4)
        of_chains = (time.process_time() - between) / 4
        costs.append(of_chains / (between - began) * len(run.plain.group))
    return np.array(costs), run._pass_work()


@pytest.mark.parametrize("name", ["finger20", "slab", "smooth clear pad"])
def test_pssmlt_against_bdpt_at_equal_time(
    name: str, mono: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    from render.integrators.film_sampler import FilmSampler
    from render.integrators.subpaths import PathLimits

    scene = picture(name, mono, tmp_path)
    sampler = FilmSampler(scene, scene.sensors()[0], PathLimits())
    costs, counted = pass_costs(sampler)
    monkeypatch.setattr(mixed_run, "PILOT_MIN", SAMPLES)
    monkeypatch.setattr(mixed_run, "PASS_COST", 0)
    monkeypatch.setattr(mixed_run, "LANES", LANES)

    @cache
    def truth() -> np.ndarray:
        longer = run_of(sampler, TRUTH * SAMPLES, TRUTH_SEED).plain
        longer.sample(-(-TRUTH * SAMPLES // len(longer.group)))
        return blocks(longer.estimate(), sampler.height, sampler.width)

    def error(images: np.ndarray) -> float:
        found = blocks(images, sampler.height, sampler.width)
        bright = truth() > 0.01 * truth().mean()
        return float(np.sqrt((((found - truth()) / truth())[bright] ** 2).mean()))

    ratios, shares, errors = [], [], []
    for seed in SEEDS:
        run = run_of(sampler, SAMPLES, seed)
        images = run.sample()
        share = run.chain_share()
        seconds = 1.0 + share / (1.0 - share) * costs.mean() / counted
        plain = run.plain.estimate()
        # Of one picture the ratio is known.
        errors.append(1.0 if np.array_equal(images, plain) else error(images) / error(plain))
        ratios.append(errors[-1] * np.sqrt(seconds))
        shares.append(share)
    with capsys.disabled():
        print(
            f"\n{name}: a pass of chains costs {costs.mean():.0f} +- "
            f"{costs.std(ddof=1) / np.sqrt(TURNS):.0f} plain samples, counted as {counted:.0f}; "
            f"seeds {SEEDS}: chains' share {np.round(shares, 3)}, errors {np.round(errors, 2)}, "
            f"equal time {np.round(ratios, 3)} (bound {BOUND})"
        )
    assert max(ratios) < BOUND
