"""The reference: transport cells by PSSMLT, with error bars, resumable at any instant.

Every pad (a bend, pressed by the pyramids or untouched) is one run per seed, in which fiber, facet
and direction node are primary dimensions (``render.cell_problem``). The path sampler serves all
cells so evenly that small steps only correlate its samples: by measurement (README.md) large steps
alone, ``p_large`` 1, are the cheapest, and the default.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from render.bending import Array
from render.camera import facet_masks
from render.errors import RenderError, TableError
from render.llvm import VARIANT, mitsuba
from render.npz import read_npz, write_npz
from render.progress import Clock, Progress
from render.scene import Scene
from render.symmetry import mirrored, mirrors

if TYPE_CHECKING:
    from render.metropolis import Chains
    from render.monte_carlo import Independent

VERSION = 3
CHUNK = 8
"""Mutations between updates of the scale and chances to save."""
SAVE_SECONDS = 20.0
CHAINS_MIN, CHAINS_MAX = 64, 16384
ITERATIONS_MIN = 24
UNTOUCHED_SHARE = 2
"""How many times more mutations a cell of the untouched pad gets: there are few of them."""
PILOT_FLOOR = 0.05
"""Least brightness, in units of the fiber's mean, to which dim cells are lifted."""


@dataclass(frozen=True)
class Estimate:
    """Rendered transport; axes ``(fiber, phi_node, bend, site, facet)``, float64.

    ``replicates`` has a leading axis of independent runs whose mean is ``T``; ``se`` is the
    standard error of that mean. The same for the untouched pad (``background``). A facet that
    the camera cannot see is NaN in all of them. Unit: 1/(mm^2 sr) per unit fiber power.
    """

    T: Array
    se: Array
    background: Array
    background_se: Array
    replicates: Array
    background_replicates: Array
    seconds: float
    settings: dict[str, object]


@dataclass(frozen=True)
class _Pad:
    """One Metropolis run: which pad, which seed, how many mutations per chain."""

    index: int
    bend: float
    indented: bool
    seed: int
    chains: int
    iterations: int

    @property
    def name(self) -> str:
        kind = "pressed" if self.indented else "untouched"
        return f"bend{self.index}-{kind}-seed{self.seed}"


def render_transport(
    scene: Scene,
    phi: Array,
    bends: Array,
    *,
    mutations: int,
    seeds: Sequence[int] = (1,),
    replicates: int = 8,
    p_large: float = 1.0,
    checkpoint: Path | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Estimate:
    """Render the transport of all fibers at all bends.

    Arguments:
        scene: the sensor.
        phi: direction nodes in rad, ``(node,)`` for all fibers or ``(fiber, node)``.
        bends: ``(bend,)`` rad, within [0, pi].
        mutations: proposed mutations per (fiber, facet) pair and seed, on average.
        seeds: independent runs; the same seeds give common random numbers between designs.
        replicates: independent chain groups per seed, for the error bars.
        p_large: probability of large steps; 1 is plain bidirectional Monte Carlo.
        checkpoint: a folder; an interrupted render goes on there and ends bit-equal.
        progress: called every few seconds.

    Raises:
        RenderError: phi or bends out of range, or no light found.
    """
    phi, bends = _validated(scene, phi, bends, mutations, seeds)
    mitsuba(VARIANT)
    pads = list(_pads(scene, phi, bends, mutations, seeds))
    key = _key(scene, phi, bends, mutations, replicates, p_large)
    clock = Clock(sum(pad.iterations * pad.chains for pad in pads), progress)
    folder = checkpoint / key if checkpoint else None
    runs = {pad.name: _run(scene, phi, pad, replicates, p_large, folder, clock) for pad in pads}
    results = {name: estimate for name, (estimate, _) in runs.items()}

    def gather(indented: bool) -> Array:
        by_bend = [
            np.stack([results[p.name] for p in pads if p.index == b and p.indented is indented])
            for b in range(len(bends))
        ]
        # (bend, seed, replicate, fiber, node, target) -> (replicate, fiber, node, bend, target)
        stacked = np.stack(by_bend).reshape(len(bends), -1, *results[pads[0].name].shape[1:3],
                                         by_bend[0].shape[-1])  # fmt: skip
        return stacked.transpose(1, 2, 3, 0, 4)

    pressed = gather(True)
    shape = (scene.sites.count, scene.indenter.faces)
    pressed = pressed.reshape(*pressed.shape[:-1], *shape)
    untouched = gather(False)
    if mirrors(scene, phi):
        pressed = 0.5 * (pressed + mirrored(scene, pressed, facets=True))
        untouched = 0.5 * (untouched + mirrored(scene, untouched, facets=False))
    count = len(pressed)
    return Estimate(
        T=pressed.mean(axis=0),
        se=pressed.std(axis=0, ddof=1) / np.sqrt(count),
        background=untouched.mean(axis=0),
        background_se=untouched.std(axis=0, ddof=1) / np.sqrt(count),
        replicates=pressed,
        background_replicates=untouched,
        seconds=sum(seconds for _, seconds in runs.values()),
        settings={
            "integrator": "pssmlt",
            "variant": VARIANT,
            "mutations_per_cell": mutations,
            "p_large": p_large,
            "seeds": list(seeds),
            "replicates_per_seed": replicates,
            "version": VERSION,
        },
    )


def _validated(
    scene: Scene, phi: Array, bends: Array, mutations: int, seeds: Sequence[int]
) -> tuple[Array, Array]:
    phi, bends = np.asarray(phi, dtype=np.float64), np.asarray(bends, dtype=np.float64)
    if phi.ndim == 1:
        phi = np.tile(phi, (scene.fibers.count, 1))
    if phi.ndim != 2 or phi.shape[0] != scene.fibers.count or phi.shape[1] == 0:
        raise RenderError(
            f"phi has shape {phi.shape}, allowed: (node,) or ({scene.fibers.count}, node)",
            field="phi",
        )
    for name, values in (("phi", phi), ("bends", bends)):
        bad = ~((values >= 0.0) & (values <= np.pi))
        if bad.any() or not values.size:
            raise RenderError(
                f"{name} = {values[bad][:1]} rad, allowed: 0 to pi", field=name, value=values
            )
    if mutations < 1 or not len(seeds) or len(set(seeds)) != len(seeds):
        raise RenderError(
            f"mutations = {mutations} and seeds = {list(seeds)}, allowed: at least 1 mutation "
            "and distinct seeds",
            field="mutations",
        )
    return phi, bends


def _pads(
    scene: Scene, phi: Array, bends: Array, mutations: int, seeds: Sequence[int]
) -> Iterator[_Pad]:
    for seed in seeds:
        for index, bend in enumerate(bends):
            for indented in (True, False):
                # One sample serves all facets of a site.
                pairs = scene.sites.count * phi.shape[0]
                total = mutations * pairs * (1 if indented else UNTOUCHED_SHARE)
                chains = CHAINS_MAX
                while chains > CHAINS_MIN and total < ITERATIONS_MIN * chains:
                    chains //= 2
                iterations = CHUNK * max(1, round(total / chains / CHUNK))
                yield _Pad(index, float(bend), indented, seed, chains, iterations)


def _key(
    scene: Scene, phi: Array, bends: Array, mutations: int, replicates: int, p_large: float
) -> str:
    """Return a hash of everything that the results depend on, except the seeds."""
    content = [scene.hash, phi.tolist(), bends.tolist(), mutations, replicates, VERSION,
               p_large, CHAINS_MAX, version("mitsuba"), version("drjit")]  # fmt: skip
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


def _run(
    scene: Scene,
    phi: Array,
    pad: _Pad,
    replicates: int,
    p_large: float,
    folder: Path | None,
    clock: Clock,
) -> tuple[Array, float]:
    """Return ``(replicate, fiber, node, target)`` of one pad and the seconds that it took."""
    finished = folder / f"{pad.name}.npz" if folder else None
    kept = _read(finished)
    if kept is not None and "estimate" in kept:
        clock.skip(pad.iterations * pad.chains)
        return kept["estimate"], float(kept["seconds"])
    problem = _problem(scene, phi, pad)
    saved = folder / f"{pad.name}.state.npz" if folder else None
    began = last = time.monotonic()
    run, spent = _start(scene, problem, pad, replicates, p_large, _read(saved))
    began -= spent
    clock.skip(run.done * pad.chains)
    while run.done < pad.iterations:
        run.mutate(CHUNK)
        clock.tick(CHUNK * pad.chains)
        if saved and time.monotonic() - last > SAVE_SECONDS:
            last = time.monotonic()
            write_npz(saved, run.state() | {"seconds": np.array(last - began)})
    estimate = run.estimate().reshape(replicates, phi.shape[0], -1, phi.shape[1])
    estimate = estimate.transpose(0, 1, 3, 2)
    empty = np.diff(problem.targets.offset) == 0
    if not np.nansum(estimate) > 0:
        raise _no_light()
    estimate[..., empty] = np.nan
    seconds = time.monotonic() - began
    if finished and saved:
        write_npz(finished, {"estimate": estimate, "seconds": np.array(seconds)})
        saved.unlink(missing_ok=True)
    return estimate, seconds


def _read(path: Path | None) -> dict[str, np.ndarray] | None:
    """Return the arrays of a checkpoint, None without one; a damaged one is rendered again."""
    if path is None or not path.exists():
        return None
    try:
        return read_npz(path)
    except TableError:
        path.unlink()
        return None


def _problem(scene: Scene, phi: Array, pad: _Pad) -> Any:
    from render.cell_problem import CellProblem, Targets

    masks = facet_masks(scene, pad.bend)
    faces = scene.indenter.faces
    chosen = range(faces) if pad.indented else (faces,)
    lists = [masks.of(site, k) for site in range(scene.sites.count) for k in chosen]
    offset = np.concatenate([[0], np.cumsum([len(pixels) for pixels in lists])])
    if offset[-1] == 0:
        raise RenderError(
            f"the camera sees no facet at a bend of {np.degrees(pad.bend):g} deg: move the camera "
            "or the sites, or raise camera.columns and camera.rows",
            field="camera",
        )
    return CellProblem(scene, phi, pad.bend, pad.indented, Targets(np.concatenate(lists), offset))


def _start(
    scene: Scene,
    problem: Any,
    pad: _Pad,
    replicates: int,
    p_large: float,
    kept: dict[str, np.ndarray] | None,
) -> tuple[Chains | Independent, float]:
    """Return a run, restored or at its beginning, and the seconds that it has cost so far."""
    from render.metropolis import Chains, Settings
    from render.monte_carlo import Independent

    settings = Settings(
        chains=pad.chains,
        luminance_samples=max(8 * pad.chains, pad.chains * pad.iterations // 8),
        p_large=p_large,
        replicates=replicates,
        seed=pad.seed,
    )
    run: Chains | Independent
    if p_large == 1.0:
        run = Independent(problem, pad.chains, replicates, pad.seed)
    else:
        run = Chains(problem, settings)
    if kept is not None:
        run.restore(kept)
        return run, float(kept["seconds"])
    if isinstance(run, Chains):
        run.bootstrap(flattening_weights(run.pilot(), scene))
    return run, 0.0


def flattening_weights(pilot: Array, scene: Scene) -> Array:
    """Return target weights ``(bin, node)`` that give every cell about the same share of F.

    From a noisy pilot, averaged over the facets of each site; dim cells are lifted only so far,
    so that a site in which the pilot saw nothing cannot draw all chains.
    """
    fibers, nodes = scene.fibers.count, pilot.shape[1]
    by_site = pilot.reshape(fibers, scene.sites.count, -1, nodes)
    level = by_site.mean(axis=2)
    floor = PILOT_FLOOR * level.mean(axis=(1, 2), keepdims=True)
    floor = np.maximum(floor, PILOT_FLOOR**2 * level.mean())
    if not level.mean() > 0:
        raise _no_light()
    weight = 1.0 / np.maximum(level, floor) / level.size
    return np.repeat(weight[:, :, None], by_site.shape[2], axis=2).reshape(pilot.shape)


def _no_light() -> RenderError:
    return RenderError(
        "no light reaches any facet: check that fibers point at the pad and that the diffuser "
        "lets light through",
        field="fibers",
    )
