"""The Mitsuba integrators ``pssmlt`` and ``bdpt``.

``bdpt``: a bidirectional path sampler with multiple importance sampling (Veach 1997) by plain
Monte Carlo, for scenes of surfaces and homogeneous media (what is not supported:
``render.integrators.supported_content``). ``pssmlt``: the same samples, and Markov chains in
primary sample space (Kelemen et al. 2002) where a pilot finds that they lower the error
(``render.integrators.mixed_run``).

Parameters, named as in Mitsuba 0.6 where it has them:

- ``max_depth`` (-1): greatest number of path edges; ``rr_depth`` (5).
- ``p_large`` (0.6), ``chains`` (16384, at most): Metropolis only.
- ``chains_only`` (false): Metropolis alone, for comparison; then ``luminance_samples`` (100000)
  plain samples, which are not deposited, fix its brightness.
- ``replicates`` (8): independent groups, for the error bars.
- ``error_bars`` (false): append one channel per color with the standard error of each pixel.

Samples per pixel count plain samples and mutations. The film's filter, crop window and formats are
kept; afterwards it holds the picture, as with Mitsuba's own integrators.
"""

from __future__ import annotations

from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.errors import RenderError
from render.integrators.film import store_picture
from render.integrators.film_sampler import FilmSampler
from render.integrators.mixed_run import LANES, MixedRun
from render.integrators.subpaths import PathLimits
from render.integrators.supported_content import refuse_gradients, refuse_variant
from render.integrators.vertex_cache import SHARED_PATHS
from render.sampling.monte_carlo import monte_carlo_replicates
from render.sampling.pssmlt import ChainSettings
from render.steady_registry import steady_registry

REPLICATES_MIN, REPLICATES_MAX = 2, 4096


class Bidirectional(mi.SamplingIntegrator):
    """What both integrators share: parameters, and images from replicates."""

    name = "bdpt"
    max_depth: int
    rr_depth: int
    replicates: int
    error_bars: bool
    options: ClassVar[dict[str, int | float | bool]] = {
        "max_depth": -1, "rr_depth": 5, "replicates": 8, "error_bars": False,
    }  # fmt: skip
    """All parameters with their defaults, whose types they have."""

    def __init__(self, props: Any) -> None:
        mi.SamplingIntegrator.__init__(self, props)
        # What is wrong is told in ``render``, where a scene that holds the integrator is loaded.
        self.given = {name: props[name] for name in props.keys()}  # noqa: SIM118 (no mapping)
        for name, default in self.options.items():
            setattr(self, name, self.given.get(name, default))
            props.mark_queried(name)

    def refuse_options(self) -> None:
        """Raise a RenderError for a parameter that is unknown, of another type or out of range."""
        options = ", ".join(self.options)
        for name, value in self.given.items():
            default = self.options.get(name)
            # Every integrator of Mitsuba has this one.
            if name == "hide_emitters" and value is False:
                continue
            if default is None:
                value = value.class_name() if isinstance(value, mi.Object) else value
                raise RenderError(
                    f"{name} = {value} is not supported by {self.name}, allowed: {options}; "
                    "leave it out, or use path or volpath",
                    field=name,
                )
            whole = type(value) is int and type(default) is float
            if type(value) is not type(default) and not whole:
                raise RenderError(
                    f"{name} = {value!r} is of type {type(value).__name__}, allowed: "
                    f"{type(default).__name__}; write {default}, say",
                    field=name,
                )
        if not REPLICATES_MIN <= self.replicates <= REPLICATES_MAX:
            raise RenderError(
                f"replicates = {self.replicates}, allowed: {REPLICATES_MIN} to {REPLICATES_MAX}",
                field="replicates",
            )

    @property
    def limits(self) -> PathLimits:
        """Return the limits on path length, checked."""
        return PathLimits(self.max_depth, self.rr_depth)

    def replicate_images(self, sampler: FilmSampler, seed: int, spp: int) -> Array:
        """Return independent images ``(replicate, pixel, channel)``."""
        raise NotImplementedError

    @steady_registry()
    def render(
        self, scene: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0, develop: bool = True,
        evaluate: bool = True,  # noqa: ARG002 - Mitsuba passes it
    ) -> Any:  # fmt: skip
        """Render the scene; returns ``(height, width, channel)``.

        Raises:
            RenderError: for parameters or content that is not supported, or where nothing is lit.
        """
        refuse_variant()
        self.refuse_options()
        refuse_gradients(mi.traverse(scene))
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        if spp == 0:
            spp = sensor.sampler().sample_count()
        sampler = FilmSampler(scene, sensor, self.limits)
        replicates = self.replicate_images(sampler, _number(seed), spp)
        if self.max_depth < 0 and not replicates.any():
            raise RenderError(
                f"no light arrives at the camera by {spp} samples per pixel, allowed: some; look "
                "for lamps inside opaque parts or turned away, and where the camera looks",
                field="emitter",
            )
        image = replicates.mean(axis=0)
        if self.error_bars:
            error = replicates.std(axis=0, ddof=1) / np.sqrt(len(replicates))
            image = np.concatenate([image, error], axis=-1)
        shape = (sampler.height, sampler.width, image.shape[-1])
        store_picture(sensor.film(), image.reshape(shape), self.aov_names())
        return sensor.film().develop() if develop else mi.TensorXf()

    def sample(self, *_: Any, **__: Any) -> Any:
        """Refuse to be asked for single rays, as integrators around this one do."""
        raise RenderError(
            f"{self.name} is inside of another integrator, which asks for single rays, allowed: "
            f"by itself; render with {self.name} alone, or put path or volpath there",
            field="integrator",
        )

    def render_forward(self, *_: Any, **__: Any) -> Any:
        """Refuse to compute gradients."""
        raise RenderError(
            f"{self.name} does not compute gradients, allowed: pictures; use prb or prbvolpath",
            field="params",
        )

    render_backward = render_forward
    refuse_gradients = staticmethod(refuse_gradients)
    """For what calls ``render`` while Dr.Jit hides gradients."""

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


class PSSMLT(Bidirectional):
    """Primary sample space Metropolis light transport, where it lowers the error of ``bdpt``."""

    name = "pssmlt"
    luminance_samples: int
    p_large: float
    chains: int
    chains_only: bool
    options: ClassVar[dict[str, int | float | bool]] = Bidirectional.options | {
        "luminance_samples": 100_000, "p_large": 0.6, "chains": 16384, "chains_only": False,
    }  # fmt: skip

    def replicate_images(self, sampler: FilmSampler, seed: int, spp: int) -> Array:
        """Divide the samples between plain ones and chains."""
        settings = ChainSettings(
            self.chains, self.luminance_samples, self.p_large, self.replicates, seed
        )
        run = MixedRun(sampler, settings, spp * sampler.bins)
        return run.sample_chains_only() if self.chains_only else run.sample()

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
