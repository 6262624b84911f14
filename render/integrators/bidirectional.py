"""The Mitsuba integrators ``pssmlt`` and ``bdpt``.

``pssmlt``: primary sample space Metropolis light transport (Kelemen et al. 2002) over a
bidirectional path sampler with multiple importance sampling (Veach 1997), for scenes of surfaces
and homogeneous media (``render.integrators.supported_content`` says what is not). ``bdpt`` is the
same sampler without Metropolis: plain Monte Carlo.

Parameters, named as in Mitsuba 0.6 where it has them:

- ``max_depth`` (-1): greatest number of path edges; ``rr_depth`` (5).
- ``luminance_samples`` (100000), ``p_large`` (0.6), ``chains`` (16384): Metropolis only.
- ``replicates`` (8): independent groups, for the error bars.
- ``error_bars`` (false): append one channel per color with the standard error of each pixel.

Samples per pixel are mutations per pixel. Pixels are box-filtered.

Metropolis flattens its target by a smoothed pilot image. It still costs more than ``bdpt`` where
paths are well sampled: on the slab scene of tests/validation (64 samples per pixel, 8x8 blocks,
squared relative error x seconds) it was 0.27, 0.14 and 0.16 at ``p_large`` 0.3, 0.6 and 0.9,
against 0.02 for a ``bdpt`` whose lanes shared nothing, and 0.013 now. Raise ``luminance_samples``
with the samples: an eighth is a pilot, some start the chains, the rest fixes b
(``render.integrators.normalization``).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import gaussian_filter

from render.arrays import Array
from render.errors import RenderError
from render.integrators.film_sampler import FilmSampler
from render.integrators.normalization import Normalization
from render.integrators.subpaths import PathLimits
from render.integrators.vertex_cache import SHARED_PATHS
from render.sampling.monte_carlo import monte_carlo_replicates
from render.sampling.pssmlt import ChainSettings, MarkovChains

CHUNK = 8
"""Mutations between updates of the normalization."""
LANES = 1 << 18
"""Lanes of one pass; every pass is traced anew."""
NORMALIZATION_GAIN = 8.0
"""What a sample of ``Normalization`` is worth in plain ones, or less: 10 to 20 on the slab."""
REPLICATES_MIN, REPLICATES_MAX = 2, 4096
KERNEL_SAMPLES = 256.0
"""Samples under the kernel that smooths the pilot."""
LEVEL_MIN = 0.02
"""Least level of the smoothed pilot, relative to the mean."""


class Bidirectional(mi.SamplingIntegrator):
    """What both integrators share: parameters, and images from replicates."""

    def __init__(self, props: Any) -> None:
        """Read the parameters."""
        mi.SamplingIntegrator.__init__(self, props)
        # Ranges are checked in ``render``: Mitsuba hides the type of an error in a constructor.
        self.max_depth = int(props.get("max_depth", -1))
        self.rr_depth = int(props.get("rr_depth", 5))
        self.replicates = int(props.get("replicates", 8))
        self.error_bars = bool(props.get("error_bars", False))

    @property
    def limits(self) -> PathLimits:
        """Return the limits on path length, checked."""
        return PathLimits(self.max_depth, self.rr_depth)

    def replicate_images(self, sampler: FilmSampler, seed: int, spp: int) -> Array:
        """Return independent images ``(replicate, pixel, channel)``."""
        raise NotImplementedError

    def render(
        self, scene: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0, develop: bool = True,
        evaluate: bool = True,
    ) -> Any:  # fmt: skip
        """Render the scene; returns ``(height, width, channel)``."""
        if not REPLICATES_MIN <= self.replicates <= REPLICATES_MAX:
            raise RenderError(
                f"replicates = {self.replicates}, allowed: {REPLICATES_MIN} to {REPLICATES_MAX}",
                field="replicates",
                value=self.replicates,
            )
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        if spp == 0:
            spp = sensor.sampler().sample_count()
        sampler = FilmSampler(scene, sensor, self.limits)
        sampler.emission.refuse_dark()
        replicates = self.replicate_images(sampler, _number(seed), spp)
        image = replicates.mean(axis=0)
        if self.error_bars:
            error = replicates.std(axis=0, ddof=1) / np.sqrt(len(replicates))
            image = np.concatenate([image, error], axis=-1)
        shape = (sampler.height, sampler.width, image.shape[-1])
        return mi.TensorXf(image.reshape(shape).astype(np.float32))

    def aov_names(self) -> list[str]:
        """Return the names of the channels that ``error_bars`` appends."""
        channels = ["Y"] if "mono" in str(mi.variant()) else ["R", "G", "B"]
        return [f"standard_error.{c}" for c in channels] if self.error_bars else []

    def traverse(self, callback: Any) -> None:
        """Expose no differentiable parameters."""


def _number(seed: Any) -> int:
    """Return a seed, which Mitsuba may hand over as an array of one, as a plain number."""
    value: Any = dr.slice(mi.UInt32(seed))
    return int(value)


def _level(pilot: Array, samples: float) -> Array:
    """Return the smoothed ``pilot`` ``(row, column)`` of so many samples, with dark parts lifted.

    The chains then visit all pixels alike; where it is 0 everywhere, the bootstrap says so.
    """
    # About KERNEL_SAMPLES under the kernel, and a few pixels at least.
    width = max(3.0, np.sqrt(KERNEL_SAMPLES * pilot.size / (4 * np.pi * samples)))
    level = gaussian_filter(pilot, width, mode="nearest")
    return np.asarray(np.maximum(level, LEVEL_MIN * pilot.mean()) + np.finfo(np.float32).tiny)


class PSSMLT(Bidirectional):
    """Primary sample space Metropolis light transport."""

    def __init__(self, props: Any) -> None:
        """Read the Metropolis parameters."""
        Bidirectional.__init__(self, props)
        self.luminance_samples = int(props.get("luminance_samples", 100_000))
        self.p_large = float(props.get("p_large", 0.6))
        self.chains = int(props.get("chains", 16384))

    def replicate_images(self, sampler: FilmSampler, seed: int, spp: int) -> Array:
        """Run the chains; the target is luminance over that of a smoothed pilot image."""
        settings = ChainSettings(
            self.chains, self.luminance_samples, self.p_large, self.replicates, seed
        )
        chains = MarkovChains(sampler, settings)
        normalization = Normalization(
            sampler, self.luminance_samples, self.chains, self.replicates, seed
        )
        weights = np.array([1.0] if sampler.channels == 1 else [0.2126, 0.7152, 0.0722])
        pilot = (normalization.pilot() @ weights).reshape(sampler.height, sampler.width)
        flat = weights / _level(pilot, normalization.for_pilot).reshape(-1, 1)
        chains.bootstrap(flat, normalization.for_starts)
        worth = NORMALIZATION_GAIN * normalization.for_estimate / self.replicates
        chains.add_estimates(normalization.means(flat), worth)
        chains.sample(CHUNK * max(1, round(spp * sampler.bins / settings.chains / CHUNK)))
        return chains.estimate()

    def to_string(self) -> str:
        """Describe the integrator."""
        return f"PSSMLT[chains = {self.chains}, p_large = {self.p_large:g}]"


class BDPT(Bidirectional):
    """The same paths by plain Monte Carlo."""

    def replicate_images(self, sampler: FilmSampler, seed: int, spp: int) -> Array:
        """Average paths; those of one replicate share their light subpaths."""
        paths = spp * sampler.bins
        passes = -(-paths // LANES)
        lanes = max(-(-paths // passes), self.replicates)
        return monte_carlo_replicates(
            sampler.sharing(lanes, self.replicates, SHARED_PATHS),
            lanes=lanes, passes=passes, replicates=self.replicates, seed=seed,
        )  # fmt: skip

    def to_string(self) -> str:
        """Describe the integrator."""
        return "BDPT[]"
