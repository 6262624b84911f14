"""What the validation tests share: cameras, rooms, independent images and their comparison.

``make validation`` runs the fast versions; ``make validation-long`` sets ``TACTILUX_LONG``, which
takes more samples and adds cases. Its results are kept in RESULTS.md.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from scipy import stats

from tests.long import LONG

METROPOLIS = {
    "chains": 4096, "luminance_samples": 1 << 20 if LONG else 1 << 15, "chains_only": True,
}  # fmt: skip


def camera(
    mi: ModuleType, origin: list[float], *, size: int = 8, fov: float = 60, target: Any = (0, 0, 0)
) -> dict[str, Any]:
    """Return a perspective sensor of ``size`` x ``size`` pixels, up +y, box filter."""
    film = {
        "type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"},
        "pixel_format": "luminance" if "mono" in str(mi.variant()) else "rgb",
    }  # fmt: skip
    to_world = mi.ScalarTransform4f().look_at(origin=origin, target=list(target), up=[0, 1, 0])
    return {"type": "perspective", "fov": fov, "to_world": to_world, "film": film}


def gray(mi: ModuleType, value: float) -> dict[str, Any]:
    """Return a gray reflectance or radiance in any variant."""
    kind = "rgb" if "rgb" in str(mi.variant()) else "uniform"
    return {"type": kind, "value": value}


def diffuse(mi: ModuleType, albedo: float) -> dict[str, Any]:
    """Return a Lambertian BSDF."""
    return {"type": "diffuse", "reflectance": gray(mi, albedo)}


def ours(
    mi: ModuleType,
    scene: Any,
    kind: str,
    spp: int,
    *,
    seed: int = 1,
    replicates: int = 16,
    **parameters: Any,
) -> np.ndarray:
    """Return independent images ``(replicate, row, column, channel)`` of ``bdpt`` or ``pssmlt``."""
    from render.integrators.film_sampler import FilmSampler

    metropolis = METROPOLIS if kind == "pssmlt" else {}
    integrator = mi.load_dict({"type": kind, "replicates": replicates, **metropolis, **parameters})
    sampler = FilmSampler(scene, scene.sensors()[0], integrator.limits)
    images = integrator.replicate_images(sampler, seed, spp)
    return np.asarray(images.reshape(replicates, sampler.height, sampler.width, -1))


def theirs(
    mi: ModuleType, scene: Any, kind: str, spp: int, *, runs: int = 16, **parameters: Any
) -> np.ndarray:
    """Return images ``(run, row, column, channel)`` of Mitsuba's own integrator, a seed each."""
    integrator = mi.load_dict({"type": kind, "max_depth": -1, "rr_depth": 1000, **parameters})
    images = [mi.render(scene, integrator=integrator, spp=spp, seed=s + 1) for s in range(runs)]
    return np.stack([np.array(image, dtype=np.float64) for image in images])


def blocks(images: np.ndarray, size: int) -> np.ndarray:
    """Return means over ``size`` x ``size`` pixels of ``(..., row, column, channel)``."""
    *lead, rows, columns, channels = images.shape
    cut = images.reshape(*lead, rows // size, size, columns // size, size, channels)
    return np.asarray(cut.mean(axis=(-4, -2)))


def relative_bar(images: np.ndarray) -> float:
    """Return the relative standard error of the mean intensity of independent images."""
    means = images.mean(axis=(1, 2, 3))
    return float(means.std(ddof=1) / np.sqrt(len(means)) / means.mean())


def not_too_many(p: np.ndarray) -> bool:
    """Return whether about 5 % of ``p`` lie below 0.05: more would be rarer than 1 in 10,000."""
    beyond = int((p < 0.05).sum())
    return bool(stats.binom.sf(beyond - 1, p.size, 0.05) > 1e-4)


def check_same(a: np.ndarray, b: np.ndarray, what: str, *, size: int = 2) -> None:
    """Fail unless two sets of independent images have the same means, within their noise.

    Welch's t test per block and channel with Bonferroni's correction, on the number of blocks
    beyond the 95 % interval, and on the mean intensity of the whole image.
    """
    first, second = blocks(a, size), blocks(b, size)
    p = stats.ttest_ind(first, second, axis=0, equal_var=False).pvalue
    whole = stats.ttest_ind(a.mean(axis=(1, 2, 3)), b.mean(axis=(1, 2, 3)), equal_var=False).pvalue
    ratio = a.mean() / b.mean()
    bar = np.hypot(relative_bar(a), relative_bar(b))
    blockwise = np.median(
        np.hypot(*(np.std(x, axis=0, ddof=1) / np.sqrt(len(x)) for x in (first, second)))
        / second.mean(axis=0)
    )
    print(
        f"{what}: ratio of means {ratio:.4f} +- {bar:.4f} (p {whole:.2g}); {p.size} blocks, median "
        f"error bar {blockwise:.1%}, least p {p.min():.2g}, beyond 95 %: {(p < 0.05).mean():.1%}"
    )
    assert np.isfinite(p).all()
    assert whole > 1e-3
    assert p.min() * p.size > 1e-3
    assert not_too_many(p)


def check_truth(images: np.ndarray, truth: np.ndarray | float, what: str, *, size: int = 2) -> None:
    """Fail unless the means of independent images are ``truth`` ``(row, column, channel)``.

    Student's t test per block with Bonferroni's correction, and of the whole image.
    """
    truth = np.broadcast_to(np.asarray(truth, dtype=np.float64), images.shape[1:])
    difference = images - truth
    # What is exact up to rounding has no spread to test against.
    rounding = 2e-5 * np.abs(truth).mean()
    block = blocks(difference, size)
    spread = np.hypot(block.std(axis=0, ddof=1) / np.sqrt(len(block)), rounding)
    t = block.mean(axis=0) / spread
    p = 2 * stats.t.sf(np.abs(t), len(block) - 1)
    means = difference.mean(axis=(1, 2, 3))
    bar = np.hypot(means.std(ddof=1) / np.sqrt(len(means)), rounding)
    whole = 2 * stats.t.sf(abs(means.mean()) / bar, len(means) - 1)
    print(
        f"{what}: mean off by {means.mean() / truth.mean():+.2e} +- {bar / truth.mean():.1e} "
        f"(p {whole:.2g}); least p of {p.size} blocks {p.min():.2g}"
    )
    assert whole > 1e-3
    assert p.min() * p.size > 1e-3
    assert not_too_many(p)
