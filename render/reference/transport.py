"""The reference: transport cells by bidirectional Monte Carlo, with error bars, resumable.

Every pad (a bend, pressed by the pyramids or untouched) is one job per seed
(``render.reference.job``). The path sampler serves all cells so evenly that small steps of
Markov chains only correlate its samples: by measurement (README.md) independent samples are the
cheapest, and the default.
"""

from __future__ import annotations

import gc
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, get_args

import numpy as np

from render.arguments import (
    as_callback,
    as_folder,
    as_kind,
    as_numbers,
    as_one_of,
    as_seeds,
    as_whole,
)
from render.arrays import Array
from render.cells.choose_sampler import check_rendered, serves_all_lamps
from render.errors import RenderError
from render.files import read_or_drop, write_npz
from render.geometry import check_seen, counted_sites, in_state, is_mirror_symmetric, mirror_image
from render.progress import Clock, OnProgress
from render.reference.allocation import EVERYTHING, PadShares, SampleAllocation, pad_shares
from render.reference.choose_samples import lamp_by_lamp_shape, shared_shape
from render.reference.convergence import doubt
from render.reference.error_bars import CellErrors, standard_error, with_lone_contributions
from render.reference.job import VERSION, RenderJob, RenderResult, Sampler, run_job
from render.reference.llvm import VARIANT
from render.scene import Scene, as_scene, scene_content

UNTOUCHED_SAMPLES = 2
"""Samples of a cell of the untouched pad, in units of those of a facet: there are few cells."""


@dataclass(frozen=True)
class TransportEstimate:
    """Rendered transport; axes ``(fiber, phi_node, bend, site, facet[, channel])``, float64.

    The axis ``channel`` is there where the skin's albedo depends on it; channels of one albedo have
    the same numbers, and the light paths of all channels begin with the same random numbers.

    ``replicates`` has a leading axis of independent runs whose mean is ``T``; ``se`` is the
    standard error of that mean, an upper bound by the rule of three where it is 0 or rests on one
    contribution (``render.reference.error_bars``). The same for the untouched pad (``background``),
    NaN where it was not rendered (``render.reference.allocation``).
    Sites are those that count (``render.geometry.seen_sites``). Unit: 1/(mm^2 sr) per unit fiber
    power.
    """

    T: Array
    se: Array
    background: Array
    background_se: Array
    replicates: Array
    background_replicates: Array
    seconds: float
    settings: dict[str, object]

    @property
    def doubt(self) -> str:
        """Say how many facets' cells have not converged, and what they need; "" if all have."""
        return doubt(self.T, self.se, int(str(self.settings["samples_per_cell"])))


ARRAYS = ("T", "se", "background", "background_se", "replicates", "background_replicates")
"""Of an estimate, all of which have the axis of channels where there is one."""


class JobRunner(Protocol):
    """Runs jobs: here, on other machines, or by looking up what was rendered before."""

    def __call__(self, jobs: Sequence[RenderJob], clock: Clock) -> Sequence[RenderResult]:
        """Return the results in the order of ``jobs``; ``clock`` is told of their samples."""


def render_transport(
    scene: Scene | str | Path,
    phi: Array,
    bends: Array,
    *,
    samples: int,
    seeds: Sequence[int] = (1,),
    replicates: int = 8,
    sampler: Sampler = "monte-carlo",
    per_pass: int | None = None,
    allocation: SampleAllocation = EVERYTHING,
    checkpoint: str | Path | None = None,
    runner: JobRunner | None = None,
    progress: OnProgress | None = None,
) -> TransportEstimate:
    """Render the transport of all fibers at all bends.

    Arguments:
        scene: the sensor, its name or its file.
        phi: direction nodes in rad, ``(node,)`` for all fibers or ``(fiber, node)``.
        bends: ``(bend,)`` rad, within [0, pi], or numbers of the scene's states.
        samples: proposed samples per (fiber, facet) pair and seed, on average.
        seeds: independent runs; the same seeds give common random numbers between designs.
        replicates: independent chain groups per seed, for the error bars.
        sampler: plain bidirectional Monte Carlo, or Markov chains over the same paths.
        per_pass: as of ``transport_jobs``.
        allocation: where the samples go.
        checkpoint: a folder; an interrupted render goes on there and ends bit-equal.
        runner: who runs the jobs instead, with checkpoints of its own (default: this process, one
            after the other).
        progress: called every few seconds.

    Raises:
        RenderError: phi or bends out of range, or no light found.
        SceneError: a site that counts is not seen at one of ``bends``.
    """
    scene, folder = as_scene(scene), as_folder(checkpoint, "checkpoint", RenderError)
    as_callback(runner, "runner", RenderError)
    as_callback(progress, "progress", RenderError)
    jobs = transport_jobs(
        scene, phi, bends, samples=samples, seeds=seeds, replicates=replicates, sampler=sampler,
        per_pass=per_pass, allocation=allocation,
    )  # fmt: skip
    clock = Clock(sum(job.samples for job in jobs), progress)
    results = (runner or local_runner(folder))(jobs, clock)
    return transport_estimate(scene, jobs, results, samples)


def local_runner(checkpoint: Path | None = None) -> JobRunner:
    """Return what runs jobs in this process, one after the other, going on from ``checkpoint``."""

    def run(jobs: Sequence[RenderJob], clock: Clock) -> list[RenderResult]:
        results = []
        for job in jobs:
            results.append(_run(job, checkpoint, clock))
            # What tracing froze counts as young no more: dead scenes would wait for the end.
            gc.collect()
        return results

    return run


def _run(job: RenderJob, folder: Path | None, clock: Clock) -> RenderResult:
    if folder is None:
        return run_job(job, tick=clock.tick)
    finished, state = folder / f"{job.name}.npz", folder / f"{job.name}.state.npz"
    kept = read_or_drop(finished)
    if kept is not None and "estimate" in kept:
        clock.skip(job.samples)
        return RenderResult.of(kept)
    result = run_job(job, state, clock.tick)
    write_npz(finished, result.arrays())
    state.unlink(missing_ok=True)
    return result


def transport_jobs(
    scene: Scene,
    phi: Array,
    bends: Array,
    *,
    samples: int,
    seeds: Sequence[int],
    replicates: int = 8,
    sampler: Sampler = "monte-carlo",
    per_pass: int | None = None,
    allocation: SampleAllocation = EVERYTHING,
) -> list[RenderJob]:
    """Return the jobs of ``render_transport`` (its arguments): seed by seed, bend by bend.

    Where the skin's albedo depends on the channel there are those of each albedo, one after the
    other: light of one channel is that of the scene whose whole skin has its albedo.

    ``per_pass`` samples per cell are one pass of independent paths. All its multiples are then
    passes of the same paths, so that a render with more of them goes on from one with fewer, and
    ends bit-equal (``render.reference.budget``); None makes as few passes as can be.

    Raises:
        RenderError: phi or bends out of range.
        SceneError: a site that counts is not seen at one of ``bends``.
    """
    as_whole(replicates, "replicates", RenderError, least=2)
    as_one_of(sampler, get_args(Sampler), "sampler", RenderError)
    if per_pass is not None:
        as_whole(per_pass, "per_pass", RenderError, least=1)
    as_kind(allocation, SampleAllocation, "allocation", "a SampleAllocation", RenderError)
    phi, bends = _validated(scene, phi, bends, samples, seeds)
    check_rendered(scene, bends)
    check_seen(scene, bends)
    # One sample serves all facets of a site.
    pairs = len(counted_sites(scene)) * phi.shape[0]
    pads: list[tuple[float, bool, PadShares | None]] = []
    given = None if allocation.shares is None else pad_shares(scene, bends, allocation.shares)
    for index, bend in enumerate(bends):
        pads.append((float(bend), True, None if given is None else given[index]))
        if allocation.untouched:
            pads.append((float(bend), False, None))
    jobs = []
    for of_albedo, seed in itertools.product(scene.one_albedo_scenes, seeds):
        for bend, indented, shares in pads:
            count = samples * (1 if indented else UNTOUCHED_SAMPLES)
            effort, slots = (1.0, None) if shares is None else (shares.effort, shares.slots)
            if sampler == "monte-carlo" and serves_all_lamps(*in_state(scene, bend)):
                # Every sample serves all lamps: there is nothing to share out among them.
                each = None if per_pass is None else per_pass * count // samples
                chains, iterations = shared_shape(scene, count, replicates, each, indented=indented)
                slots = None
            else:
                chains, iterations = lamp_by_lamp_shape(count, pairs, sampler, per_pass, effort)
            jobs.append(
                RenderJob.of(
                    of_albedo,
                    phi,
                    bend=bend,
                    indented=indented,
                    seed=seed,
                    chains=chains,
                    iterations=iterations,
                    replicates=replicates,
                    sampler=sampler,
                    slots=slots,
                )
            )
    return jobs


def transport_estimate(
    scene: Scene, jobs: Sequence[RenderJob], results: Sequence[RenderResult], samples: int
) -> TransportEstimate:
    """Return the transport that the jobs of ``transport_jobs`` found.

    Arguments:
        scene: the sensor.
        jobs: every seed at every bend, pressed and untouched, all with the same nodes; seeds and
            bends in the estimate are in the order of their first job. Where the skin's albedo
            depends on the channel, those of each albedo.
        results: of the jobs.
        samples: per (fiber, facet) pair and seed, as ``transport_jobs`` was asked for.
    """
    if not scene.by_channel:
        return _one_albedo_estimate(scene, jobs, results, samples)
    found = []
    for of_albedo in scene.one_albedo_scenes:
        content = scene_content(of_albedo)
        own = [number for number, job in enumerate(jobs) if job.scene == content]
        of_own = [jobs[number] for number in own], [results[number] for number in own]
        found.append(_one_albedo_estimate(of_albedo, *of_own, samples))
    stacked: dict[str, Any] = {
        name: np.stack([getattr(found[i], name) for i in scene.albedo_of_channel], axis=-1)
        for name in ARRAYS
    }
    return replace(found[0], **stacked, seconds=sum(one.seconds for one in found))


def _one_albedo_estimate(
    scene: Scene, jobs: Sequence[RenderJob], results: Sequence[RenderResult], samples: int
) -> TransportEstimate:
    bends = list(dict.fromkeys(job.bend for job in jobs))
    seeds = list(dict.fromkeys(job.seed for job in jobs))
    found = {
        (job.bend, job.indented, job.seed): result
        for job, result in zip(jobs, results, strict=True)
    }
    first, phi = jobs[0], np.array(jobs[0].phi)
    symmetric = is_mirror_symmetric(scene, phi)

    counted = len(counted_sites(scene))

    def pads(indented: bool) -> tuple[Array, CellErrors]:
        shape = (counted, scene.indenter.faces) if indented else (counted,)

        def stacked(name: str) -> Array:
            # (bend, seed, [replicate,] fiber, node, target) -> (replicate, fiber, node, bend, ...)
            parts = np.stack(
                [[getattr(found[bend, indented, seed], name) for seed in seeds] for bend in bends]
            )
            parts = parts.reshape(len(bends), -1, *parts.shape[-3:]).transpose(1, 2, 3, 0, 4)
            return parts.reshape(*parts.shape[:-1], *shape)

        replicates, largest = stacked("estimate"), stacked("largest").max(axis=0) / len(seeds)
        if symmetric:
            replicates = 0.5 * (replicates + mirror_image(scene, replicates, facets=indented))
            largest = 0.5 * np.maximum(largest, mirror_image(scene, largest, facets=indented))
        mean = replicates.mean(axis=0)
        effort = samples_of_cells(jobs, bends) if indented else None
        return replicates, CellErrors(mean, standard_error(replicates, effort), largest, effort)

    pressed, facets = pads(True)
    if all(job.indented for job in jobs):
        untouched = np.full(pressed.shape[:-1], np.nan)
        sites = CellErrors(untouched[0], untouched[0], untouched[0])
    else:
        untouched, sites = pads(False)
    se, background_se = with_lone_contributions(facets, sites, UNTOUCHED_SAMPLES)
    return TransportEstimate(
        T=facets.mean,
        se=se,
        background=sites.mean,
        background_se=background_se,
        replicates=pressed,
        background_replicates=untouched,
        seconds=sum(result.seconds for result in results),
        settings={
            "sampler": first.sampler,
            "variant": VARIANT,
            "samples_per_cell": samples,
            "seeds": seeds,
            "replicates_per_seed": first.replicates,
            "version": VERSION,
        },
    )


def samples_of_cells(jobs: Sequence[RenderJob], bends: Sequence[float]) -> Array | None:
    """Return what the cells of the pressed pads got, ``(fiber, 1, bend, site, 1)``, mean 1.

    Arguments:
        jobs: of ``transport_jobs``.
        bends: in the order of the axis.

    None where no job says how its samples are shared.
    """
    pads = {job.bend: job for job in jobs if job.indented}
    if any(job.slots is None for job in pads.values()):
        return None
    slots = np.array([pads[bend].slots for bend in bends], dtype=np.float64)
    effort = np.array([pads[bend].samples for bend in bends])
    each = slots / slots.sum(axis=(1, 2), keepdims=True) * effort[:, None, None]
    return np.asarray((each / each.mean()).transpose(2, 0, 1)[:, None, :, :, None])


def _validated(
    scene: Scene, phi: Array, bends: Array, samples: int, seeds: Sequence[int]
) -> tuple[Array, Array]:
    phi, bends = as_numbers(phi, "phi", RenderError), as_numbers(bends, "bends", RenderError)
    if bends.ndim != 1:
        raise RenderError(f"bends has shape {bends.shape}, allowed: (bend,)", field="bends")
    if phi.ndim == 1:
        phi = np.tile(phi, (scene.lamp_count, 1))
    if phi.ndim != 2 or phi.shape[0] != scene.lamp_count or phi.shape[1] == 0:
        raise RenderError(
            f"phi has shape {phi.shape}, allowed: (node,) or ({scene.lamp_count}, node)",
            field="phi",
        )
    if scene.states is not None:
        for state in set(bends.ravel().tolist()) - set(scene.state_axis):
            scene.in_state(state)  # says what there is
    angles = bends if scene.states is None else np.zeros(bends.size)
    for name, values in (("phi", phi), ("bends", angles)):
        bad = ~((values >= 0.0) & (values <= np.pi))
        if bad.any() or not values.size:
            raise RenderError(f"{name} = {values[bad][:1]} rad, allowed: 0 to pi", field=name)
    as_whole(samples, "samples", RenderError, least=1)
    as_seeds(seeds, RenderError)
    return phi, bends
