"""The slab under a point light with a Gaussian profile, as Mitsuba 0.6's ``bdpt`` renders it.

The light: a point at (10.4, 0, 2), axis -x, intensity 1000 exp(-theta^2 / (2 (15 deg)^2)) per
steradian, cut at 60 deg. No emitter of ours is that exactly: a ``fiber`` end radiates the same
Gaussian times the cosine of its face. The test's own emitter is a fiber end of 0.01 mm radius
whose radiance is divided by that cosine, and goes through the sampler as every fiber does.
``slab_gauss_beckmann_blocks.npz`` holds means over 8x8 pixels and their standard errors.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.validation.film import LONG, ours
from tests.validation.test_slab_reference import COATED, blocks, slab

BLOCKS = Path(__file__).with_name("slab_gauss_beckmann_blocks.npz")
RADIUS = 0.01
SPP = 1024 if LONG else 64


def gaussian_point(mono: ModuleType) -> dict[str, Any]:
    """Return a disk so small that it is a point, with the reference's intensity."""
    import drjit as dr

    import render.integrators.fiber_emitter
    from render.optics.fiber_profile import angle

    # The sampler knows emitters that are written in Python by this name.
    class FiberEmitter(render.integrators.fiber_emitter.FiberEmitter):
        def radiance(self, local: Any) -> Any:
            inside = angle(local) < np.radians(60)
            value = render.integrators.fiber_emitter.FiberEmitter.radiance(self, local)
            return dr.select(inside, value / dr.maximum(local.z, 0.1), 0.0)

    mono.register_emitter("gaussian_point", FiberEmitter)
    transform = mono.ScalarTransform4f()
    # exp(-theta^2 / (4 sigma_v^2)) with sigma_v = 15 deg / sqrt(2).
    return {
        "type": "disk",
        "to_world": transform.translate([10.4, 0, 2]).rotate([0, 1, 0], -90).scale(RADIUS),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}},
        "emitter": {
            "type": "gaussian_point", "sigma_v": 15 / np.sqrt(2),
            "radiance": 1000 / (np.pi * RADIUS**2),
        },
    }  # fmt: skip


@pytest.mark.parametrize("kind", ["bdpt", "pssmlt"] if LONG else ["bdpt"])
def test_the_coated_part_looks_as_in_mitsuba_06(
    mono: ModuleType, tmp_path: Path, kind: str
) -> None:
    scene = slab(mono, tmp_path, gaussian_point(mono))
    images = blocks(ours(mono, scene, kind, SPP, seed=5)[..., 0])
    with np.load(BLOCKS) as stored:
        theirs, their_error = stored["bdpt06"], stored["bdpt06_se"]
    mean, error = images.mean(axis=0), images.std(axis=0, ddof=1) / np.sqrt(len(images))
    score = ((mean - theirs) / np.hypot(error, their_error))[COATED]
    ratio = mean[COATED].mean() / theirs[COATED].mean()
    ours_alone = images[:, *COATED].mean(axis=(1, 2))
    bar = np.hypot(
        ours_alone.std(ddof=1) / np.sqrt(len(images)) / ours_alone.mean(),
        np.sqrt((their_error[COATED] ** 2).sum()) / theirs[COATED].sum(),
    )
    print(
        f"slab_gauss, {kind}: coated part {ratio:.4f} +- {bar:.4f} of bdpt06; median error bar of "
        f"blocks {np.median(error / mean):.1%} (theirs {np.median(their_error / theirs):.1%}); "
        f"score: mean {score.mean():+.2f}, sd {score.std():.2f}, largest {np.abs(score).max():.1f}"
    )
    assert abs(ratio - 1) < 3 * bar
    assert (np.abs(score) < 3).mean() > 0.9
