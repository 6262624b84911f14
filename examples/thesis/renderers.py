"""Figs. 3.2 and 3.3 of the thesis: renderers compared, and the luminance scale.

- Fig. 3.2: one picture of finger20 by path tracing (Mitsuba's ``volpath``), ``bdpt`` and ``pssmlt``
  at equal samples per pixel and at equal processor time, with the relative error of each against
  a long ``bdpt`` render of another seed.
- Fig. 3.3: the standard deviation of the mean intensity over independent seeds against the number
  of luminance samples, relative to the mean.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from render.arrays import Array
from render.scene import load_scene

WIDTH, HEIGHT = 96, 160
# Errors are taken over square blocks of so many pixels, where the coating fills the picture.
BLOCK = 8
COATED = np.s_[48:, 16:80]
GRAYS = 32
"""Gray levels of Fig. 3.2, whose noise would fill half a megabyte otherwise."""
SEEDS = 8
INTEGRATORS = ("volpath", "bdpt", "pssmlt")
SAMPLES = (10_000, 100_000, 1_000_000, 10_000_000)


@dataclass(frozen=True)
class Rendering:
    """One render: radiance ``(row, column)`` float64, samples per pixel, processor seconds."""

    integrator: str
    picture: Array
    spp: int
    seconds: float

    def error(self, truth: Array) -> float:
        """Return the root mean square relative error over blocks."""
        measured, expected = blocks(self.picture[COATED]), blocks(truth[COATED])
        return float(np.sqrt((((measured - expected) / expected) ** 2).mean()))


def blocks(picture: Array) -> Array:
    """Return block means of ``(row, column)``."""
    rows, columns = picture.shape
    cut = picture.reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK)
    return np.asarray(cut.mean(axis=(1, 3)))


def sensor() -> Any:
    """Return finger20 with all fibers lit, flat, as a Mitsuba scene."""
    from render.optics.lit_scene import lit_scene

    scene = load_scene("finger20")
    count = scene.lamp_count
    return lit_scene(
        scene, np.full(count, np.pi / 2), np.ones(count), 0.0, width=WIDTH, height=HEIGHT
    )


def pictures(
    lit: Any, spp: int, seconds: float, say: Callable[[str], None]
) -> tuple[dict[str, list[Rendering]], Array]:
    """Return shots at equal samples and at equal time, and the long render they are held to."""
    import mitsuba as mi

    def shoot(integrator: str, samples: int, seed: int) -> Rendering:
        say(f"{integrator}, {samples} samples per pixel")
        depth = {"max_depth": -1, "rr_depth": 1000} if integrator == "volpath" else {}
        plugin: Any = mi.load_dict({"type": integrator, **depth})
        began = time.process_time()
        total = np.zeros((HEIGHT, WIDTH))
        # In parts, so that no wavefront of Mitsuba's own outgrows the memory.
        parts = max(1, samples // 64) if integrator == "volpath" else 1
        for part in range(parts):
            image = np.array(plugin.render(lit, seed=seed * 1000 + part, spp=samples // parts))
            total += image[..., 0] / parts
        return Rendering(integrator, total, samples, time.process_time() - began)

    shoot("bdpt", 1, 0)
    equal_samples = [shoot(name, spp, 1) for name in INTEGRATORS]
    equal_time = [
        shoot(shot.integrator, max(1, round(shot.spp * seconds / shot.seconds)), 2)
        for shot in equal_samples
    ]
    shots = [*equal_samples, *equal_time]
    truth = shoot("bdpt", 4 * max(shot.spp for shot in shots if shot.integrator == "bdpt"), 3)
    return {"equal samples": equal_samples, "equal time": equal_time}, truth.picture


def luminance_scale(lit: Any, most: int, say: Callable[[str], None]) -> list[dict[str, float]]:
    """Return the relative standard deviation of the mean intensity per luminance samples."""
    from render.integrators.film_sampler import FilmSampler
    from render.integrators.mixed_run import LANES
    from render.integrators.subpaths import PathLimits
    from render.integrators.vertex_cache import SHARED_PATHS
    from render.sampling.monte_carlo import monte_carlo_replicates

    sampler = FilmSampler(lit, lit.sensors()[0], PathLimits())
    rows = []
    for wanted in SAMPLES:
        samples = min(wanted, most)
        passes = -(-samples // LANES)
        lanes = -(-samples // passes)
        sharing = sampler.sharing(lanes, 2, SHARED_PATHS)
        means = np.array(
            [
                monte_carlo_replicates(
                    sharing, lanes=lanes, passes=passes, replicates=2, seed=seed
                ).mean()
                for seed in range(SEEDS)
            ]
        )
        spread = float(means.std(ddof=1) / means.mean())
        # The last one is the standard error of a standard deviation from so few seeds.
        rows.append(
            {
                "luminance_samples": samples,
                "relative_std": spread,
                "relative_std_se": spread / float(np.sqrt(2 * (SEEDS - 1))),
            }
        )
        say(f"{samples} luminance samples: {100 * spread:.2f} %")
        if wanted >= most:
            break
    return rows


def draw_pictures(shots: dict[str, list[Rendering]], truth: Array, path: Path) -> None:
    """Write Fig. 3.2: every pixel of a render is four of the picture, in so many gray levels."""
    import io

    from matplotlib.figure import Figure
    from PIL import Image

    gap, head, dpi = 12, 56, 100
    cell = np.array([2 * WIDTH + gap, 2 * HEIGHT + head])
    size = cell * (len(INTEGRATORS) + 1, len(shots))
    figure = Figure(figsize=tuple(size / dpi), dpi=dpi)
    top = np.percentile(truth, 99)

    def show(row: int, column: int, picture: Array, title: str) -> None:
        left, bottom = cell[0] * column + gap / 2, cell[1] * (len(shots) - 1 - row)
        place = np.array([left, bottom, 2 * WIDTH, 2 * HEIGHT]) / np.tile(size, 2)
        axis = figure.add_axes(tuple(place))
        bright = np.clip(picture / top, 0, 1) ** (1 / 2.2)
        axis.imshow(bright, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        axis.set_title(title, fontsize=8)
        axis.set_axis_off()

    for row, (at, pictures) in enumerate(shots.items()):
        for column, shot in enumerate(pictures):
            title = f"{shot.integrator}, {at}\n{shot.spp} spp, {shot.seconds:.0f} s"
            show(row, column, shot.picture, f"{title}\nerror {100 * shot.error(truth):.1f} %")
        show(row, len(pictures), truth, "bdpt, long")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    gray = Image.open(stream).convert("L").quantize(GRAYS)
    gray.save(path, "png", optimize=True)


def draw_scale(rows: list[dict[str, float]], path: Path) -> None:
    """Write Fig. 3.3."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 4), layout="constrained")
    axis = figure.subplots()
    samples = np.array([row["luminance_samples"] for row in rows])
    spread = 100 * np.array([row["relative_std"] for row in rows])
    error = 100 * np.array([row["relative_std_se"] for row in rows])
    axis.errorbar(samples, spread, error, fmt="o-", capsize=3, label="measured")
    axis.axhline(0.2, color="gray", linestyle="--", label="0.2 %")
    axis.set(xscale="log", yscale="log", xlabel="luminance samples")
    axis.set_ylabel("standard deviation of the mean intensity (%)")
    axis.legend()
    figure.savefig(path, dpi=120)
