"""What ``pssmlt`` loses or wins against ``bdpt`` on pictures, at equal time.

Both make as many samples in one run each, with kernels from the cache. Equal time = the ratio of
the errors x the root of the ratio of the processor times: what an error would be to the other one
had both run as long. Above 1 ``pssmlt`` loses; the product's bound is 1.15.

Errors are root mean squares over blocks of 8 x 8 pixels of the distance from a longer picture by
``bdpt`` of another seed, relative to it; blocks darker than a hundredth of the mean are left out.
Replicates would not do: of light that few of them have seen they state too little.
"""

from __future__ import annotations

import time
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from render.integrators.mixed_run import PILOT_MIN
from render.scene import load_scene
from tests.oracles.pads import scene_of_case
from tests.validation.test_slab_reference import lamp, slab

REPLICATES = 16
BLOCK = 8
SAMPLES = PILOT_MIN
"""From here on pilots are made."""
TRUTH = 3
"""Times as many samples."""
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


@pytest.mark.parametrize("name", ["finger20", "slab", "smooth clear pad"])
def test_pssmlt_against_bdpt_at_equal_time(
    name: str, mono: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from render.integrators.film_sampler import FilmSampler

    scene = picture(name, mono, tmp_path)

    def drawn(kind: str, seed: int, times: float) -> tuple[np.ndarray, float]:
        """Return blocks of a picture and its processor seconds."""
        plugin: Any = mono.load_dict({"type": kind, "replicates": REPLICATES})
        sampler = FilmSampler(scene, scene.sensors()[0], plugin.limits)
        began = time.process_time()
        images = plugin.replicate_images(sampler, seed, round(times * SAMPLES / sampler.bins) + 1)
        seconds = time.process_time() - began
        return blocks(images, sampler.height, sampler.width), seconds

    truth, _ = drawn("bdpt", 1, TRUTH)
    bright = truth > 0.01 * truth.mean()
    error, seconds = {}, {}
    for kind in ("bdpt", "pssmlt"):
        # Kernels are compiled in a first run, those of the chains too.
        drawn(kind, 3, 1.0 if kind == "pssmlt" else 0.1)
        found, seconds[kind] = drawn(kind, 2, 1.0)
        error[kind] = float(np.sqrt((((found - truth) / truth)[bright] ** 2).mean()))
    ratio = error["pssmlt"] / error["bdpt"] * np.sqrt(seconds["pssmlt"] / seconds["bdpt"])
    with capsys.disabled():
        print(
            f"\n{name}: bdpt {100 * error['bdpt']:.2f} % in {seconds['bdpt']:.1f} s, pssmlt "
            f"{100 * error['pssmlt']:.2f} % in {seconds['pssmlt']:.1f} s, equal time {ratio:.2f} "
            f"(bound {BOUND})"
        )
    assert np.isfinite(ratio)
