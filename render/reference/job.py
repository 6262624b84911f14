"""One render of one pad: a job that is plain data, so that it runs here or on another machine.

A pad is the sensor at one bend, pressed by the pyramids or untouched. Fiber, facet and direction
node are primary dimensions of its run (``render.cells.cell_sampler``), so one job fills the cells
of all of them, and nothing but the job decides its result.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from render.arrays import Array
from render.cells.choose_sampler import STRATA, serves_all_lamps
from render.errors import RenderError
from render.files import read_or_drop, write_npz
from render.geometry import counted_sites, facet_masks, in_state
from render.reference.llvm import VARIANT, mitsuba
from render.scene import Scene, scene_content, scene_of
from render.steady_registry import steady_registry
from render.steady_sums import steady_sums

if TYPE_CHECKING:
    from render.sampling.monte_carlo import MonteCarlo
    from render.sampling.pssmlt import MarkovChains

VERSION = 21
SHARED_VERSION = 4
"""Of renders of all lamps at once (``render.cells.choose_sampler``)."""
Sampler = Literal["monte-carlo", "pssmlt"]
P_LARGE = 0.5
"""Probability of large steps where chains fill the cells."""
CHUNK = 8
"""Samples between updates of the scale and chances to save."""
SAVE_SECONDS = 20.0
PILOT_FLOOR = 0.05
"""Least brightness, in units of the fiber's mean, to which dim cells are lifted."""


@dataclass(frozen=True)
class RenderJob:
    """What one run renders; JSON-able by ``to_json``.

    Arguments:
        scene: content of the sensor (``render.scene.serialization``).
        phi: direction nodes ``(fiber, node)`` in rad.
        bend: rad, or the number of one of the scene's states.
        indented: pressed by the pyramids, or untouched.
        seed: of all random numbers.
        chains: paths at once.
        iterations: samples per chain, a multiple of ``chunk``.
        replicates: independent groups of chains.
        sampler: plain bidirectional Monte Carlo, or Markov chains over the same paths.
        slots: the samples' shares ``(site, fiber)`` (``render.cells.sample_shares``); None for
            those that favor near fibers.
    """

    scene: str
    phi: tuple[tuple[float, ...], ...]
    bend: float
    indented: bool
    seed: int
    chains: int
    iterations: int
    replicates: int = 8
    sampler: Sampler = "monte-carlo"
    slots: tuple[tuple[int, ...], ...] | None = None

    @classmethod
    def of(cls, scene: Scene, phi: Array, **rest: Any) -> RenderJob:
        """Return the job of ``scene`` at nodes ``phi`` ``(fiber, node)`` rad."""
        return cls(scene_content(scene), tuple(tuple(row) for row in phi.tolist()), **rest)

    @property
    def samples(self) -> int:
        """Samples of all chains together: the size of the job."""
        return self.chains * self.iterations

    @property
    def chunk(self) -> int:
        """Samples per chain between chances to save; independent paths need no more than one."""
        return 1 if self.sampler == "monte-carlo" else CHUNK

    @cached_property
    def key(self) -> str:
        """A hash of everything that the result depends on, 64 hex digits."""
        scene_hash, bend, serves_all = _pad(self.scene, self.bend)
        content = asdict(self) | {"scene": scene_hash, "bend": bend}
        if self.slots is None:
            del content["slots"]
        marks = [SHARED_VERSION] if self.sampler == "monte-carlo" and serves_all else []
        text = json.dumps([VERSION, _programs(), content, *marks], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def name(self) -> str:
        """What a person may call it; with the first digits of the key, so no two are the same."""
        pad = "pressed" if self.indented else "untouched"
        scene, state = scene_of(self.scene), f"bend{math.degrees(self.bend):.0f}"
        if scene.states is not None:
            state = scene.state_names[int(self.bend)]
        return f"{state}-{pad}-seed{self.seed}-{self.key[:16]}"

    def to_json(self) -> str:
        """Return the job as text."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> RenderJob:
        """Return the job that ``to_json`` wrote."""
        content = json.loads(text)
        content["phi"] = tuple(tuple(row) for row in content["phi"])
        if content["slots"] is not None:
            content["slots"] = tuple(tuple(row) for row in content["slots"])
        return cls(**content)


@dataclass(frozen=True, eq=False)
class RenderResult:
    """Transport of one pad.

    Arguments:
        estimate: ``(replicate, fiber, node, target)``, float64; targets are ``(site, facet)``
            flattened, or sites of the untouched pad.
        largest: what the largest contribution adds to their mean, ``(fiber, node, target)``; of
            chains the largest replicate.
        seconds: spent on it, all attempts together.
    """

    estimate: Array
    largest: Array
    seconds: float

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what goes into a file."""
        return {
            "estimate": self.estimate, "largest": self.largest, "seconds": np.array(self.seconds)
        }  # fmt: skip

    @classmethod
    def of(cls, arrays: dict[str, np.ndarray]) -> RenderResult:
        """Return the result in the arrays of a file."""
        return cls(arrays["estimate"], arrays["largest"], float(arrays["seconds"]))


@lru_cache(maxsize=64)
def _pad(content: str, bend: float) -> tuple[str, float, bool]:
    """Return a pad's scene hash and bend, and whether all of its lamps are rendered at once."""
    scene, bend = in_state(scene_of(content), bend)
    return scene.hash, bend, serves_all_lamps(scene, bend)


@lru_cache(maxsize=1)
def _programs() -> list[str]:
    return [version("mitsuba"), version("drjit")]


@steady_sums()
def run_job(
    job: RenderJob,
    state: Path | None = None,
    tick: Callable[[int], None] | None = None,
    *,
    keep: bool = False,
) -> RenderResult:
    """Run ``job``.

    Arguments:
        job: what is rendered.
        state: a file that is written now and then; an interrupted run goes on from it and ends
            bit-equal.
        tick: called with the number of samples since the last call; those of an earlier run
            first. What it raises ends the run, after its state is saved.
        keep: save the state at the end too: a job of the same paths with more iterations goes on
            from there.

    Raises:
        RenderError: no light found.
    """
    mitsuba(VARIANT)
    phi = np.array(job.phi)
    scene, bend = in_state(scene_of(job.scene), job.bend)
    slots = None if job.slots is None else np.array(job.slots)
    cells = pad_cells(scene, phi, bend, job.indented, job.sampler, slots)
    began = last = time.monotonic()
    run, spent = _start(scene, cells, job, None if state is None else read_or_drop(state))
    began -= spent

    def save() -> None:
        if state is not None:
            write_npz(state, run.state() | {"seconds": np.array(time.monotonic() - began)})

    report = tick or (lambda _: None)
    if run.done:
        report(run.done * job.chains)
    while run.done < job.iterations:
        run.sample(job.chunk)
        try:
            report(job.chunk * job.chains)
        except BaseException:
            save()
            raise
        if time.monotonic() - last > SAVE_SECONDS:
            last = time.monotonic()
            save()
    if keep:
        save()
    estimate, largest = (
        array.reshape(*array.shape[:-2], phi.shape[0], -1, phi.shape[1]).swapaxes(-1, -2)
        for array in (run.estimate(), run.largest())
    )
    if not estimate.sum() > 0:
        raise _no_light()
    return RenderResult(estimate, largest, time.monotonic() - began)


@lru_cache(maxsize=64)
def _target_pixels(scene: Scene, bend: float, indented: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the targets' pixels and offsets; drawing the masks takes longer than a short run."""
    masks = facet_masks(scene, bend)
    faces = scene.indenter.faces
    chosen = range(faces) if indented else (faces,)
    lists = [masks.of(site, k) for site in counted_sites(scene) for k in chosen]
    offset = np.concatenate([[0], np.cumsum([len(pixels) for pixels in lists])])
    return np.concatenate(lists), offset


@steady_registry()
def pad_cells(
    scene: Scene,
    phi: Array,
    bend: float,
    indented: bool,
    sampler: Sampler = "monte-carlo",
    slots: np.ndarray | None = None,
) -> Any:
    """Return the path sampler of all cells of a pad; ``phi`` ``(fiber, node)`` and ``bend`` in rad.

    ``slots`` are those of a `RenderJob`. Every site that counts has to be seen at ``bend``
    (`render.geometry.check_seen`).
    """
    from render.cells.cell_sampler import CellSampler, Targets
    from render.cells.clear.clear_cells import ClearCells

    pixel, offset = _target_pixels(scene, bend, indented)
    if sampler == "monte-carlo" and serves_all_lamps(scene, bend):
        return ClearCells(scene, phi, indented, Targets(pixel, offset), STRATA)
    return CellSampler(scene, phi, bend, indented, Targets(pixel, offset), slots)


def _start(
    scene: Scene, cells: Any, job: RenderJob, saved: dict[str, np.ndarray] | None
) -> tuple[MarkovChains | MonteCarlo, float]:
    """Return a run, restored or at its beginning, and the seconds that it has cost so far."""
    from render.sampling.monte_carlo import MonteCarlo
    from render.sampling.pssmlt import ChainSettings, MarkovChains

    settings = ChainSettings(
        chains=job.chains,
        luminance_samples=max(8 * job.chains, job.samples // 8),
        p_large=P_LARGE,
        replicates=job.replicates,
        seed=job.seed,
    )
    run: MarkovChains | MonteCarlo
    if job.sampler == "monte-carlo":
        run = MonteCarlo(cells, job.chains, job.replicates, job.seed)
    else:
        run = MarkovChains(cells, settings)
    if saved is not None:
        run.restore(saved)
        return run, float(saved["seconds"])
    if isinstance(run, MarkovChains):
        run.bootstrap(flattening_weights(run.pilot(), scene))
    return run, 0.0


def flattening_weights(pilot: Array, scene: Scene) -> Array:
    """Return target weights ``(bin, node)`` that give every cell about the same share of F.

    From a noisy pilot, averaged over the facets of each site; dim cells are lifted only so far,
    so that a site in which the pilot saw nothing cannot draw all chains.
    """
    fibers, nodes = scene.lamp_count, pilot.shape[1]
    by_site = pilot.reshape(fibers, len(counted_sites(scene)), -1, nodes)
    level = by_site.mean(axis=2)
    floor = PILOT_FLOOR * level.mean(axis=(1, 2), keepdims=True)
    floor = np.maximum(floor, PILOT_FLOOR**2 * level.mean())
    if not level.mean() > 0:
        raise _no_light()
    weight = 1.0 / np.maximum(level, floor) / level.size
    return np.repeat(weight[:, :, None], by_site.shape[2], axis=2).reshape(pilot.shape)


def _no_light() -> RenderError:
    return RenderError(
        "no light from any facet: check that fibers point at the pad, that the diffuser lets light "
        "through and that coating.albedo is above 0",
        field="fibers",
    )
