"""Converged transport of a pad at one bend, or in one state of its skin.

Light that a diffuser has scattered widely is a product, T = U H: ``U`` is what leaves the layer
(`exit_field`), ``H`` what a facet gets of it (`gathering`). Other light is too narrow for the terms
of U: `arrivals` follows it to the coating, and ``H`` has what the coating sends on. The camera
mixes facets as in the shader's preview (`render.preview.facet_blur`).
"""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.finished_parts import NOTHING_KEPT, FinishedParts
from render.geometry import counted_sites, flat_fiber_poses, in_state
from render.preview.beams import shines_past_layers
from render.preview.bonded import with_bonded_window
from render.preview.converged.arrivals import (
    PHOTONS_AT_A_TIME,
    Arrivals,
    Flown,
    arrivals,
    batches,
    flown,
    no_arrivals,
    receivers_at,
)
from render.preview.converged.block import bent_block, cell_count, face_grid, term_count, wide_from
from render.preview.converged.color_noise import MAX_ROUNDS, NOISE_LIMIT, Halved, color_noise
from render.preview.converged.exit_field import exit_field
from render.preview.converged.irradiance import Gathering, field_of, irradiance
from render.preview.converged.walks import FaceGrid
from render.preview.facet_blur import facet_blurs, lines_of_sight, ring_count
from render.progress import Clock
from render.scene import Scene

FIELD_COST = 2
"""Times that a photon of an exit field takes longer than a path from a facet."""
FEWEST_ARRIVALS = 1000
"""Photons of a lamp at least."""
SAVE_SECONDS = 2.0
"""Between sums of photons that are kept."""
WALKING = 3.0
"""So many times longer photons fly at most where they walk in a diffuser, and are fewer."""


@dataclass(frozen=True)
class Effort:
    """Light paths: ``photons`` of a lamp for its exit field, ``paths`` from a facet.

    ``arrivals`` are photons for all light that is too narrow for it, of all lamps in all states;
    where colors are noisy they are followed ``rounds`` times at most.
    """

    photons: int = 200_000
    paths: int = 32_768
    arrivals: int = 40_000_000
    rounds: int = MAX_ROUNDS


def spreads(scene: Scene) -> NDArray[np.bool_]:
    """Return ``(lamp,)`` whether a lamp shines through the diffuser: its exit field is made."""
    return flat_fiber_poses(scene).layer > 0.0


def flies(scene: Scene) -> NDArray[np.bool_]:
    """Return ``(lamp,)`` whether some of a lamp's light is too narrow for the exit field."""
    return ~spreads(scene) | (wide_from(scene) > 0) | shines_past_layers(scene)


def task_count(scene: Scene, effort: Effort) -> int:
    """Return the ticks of the clock that `transport_at` takes for one bend, but for more photons.

    One for every facet and spot; for lamps as many as their light takes so many times longer.
    """
    lamps = int(spreads(scene).sum()) * _field_ticks(effort) + _arrival_ticks(scene, effort)
    ticks = lamps + len(counted_sites(scene)) * (scene.indenter.faces + 1)
    return ticks * (1 if scene.coating.lobe is None else len(scene.albedos))


def _arrival_ticks(scene: Scene, effort: Effort) -> int:
    batches = -(-_photons(scene, effort) // PHOTONS_AT_A_TIME)
    return int(flies(scene).sum()) * batches * _batch_ticks(scene, effort)


def _field_ticks(effort: Effort) -> int:
    return max(1, round(FIELD_COST * effort.photons / effort.paths))


def _batch_ticks(scene: Scene, effort: Effort) -> int:
    return max(1, round(flight_cost(scene) * PHOTONS_AT_A_TIME / effort.paths))


def flight_cost(scene: Scene) -> float:
    """Return how many times longer photons fly than in a clear pad; most just pass a thin layer."""
    layer = scene.diffuser
    if layer is None:
        return 1.0
    return min(WALKING, 1.0 + (layer.sigma_s + layer.sigma_a) * layer.thickness)


def _photons(scene: Scene, effort: Effort) -> int:
    """Return the photons of a lamp at one bend whose light is too narrow for the exit field."""
    shares = max(1, int(flies(scene).sum()) * len(scene.state_axis))
    return max(FEWEST_ARRIVALS, int(effort.arrivals // shares / flight_cost(scene)))


class ConvergedTransport(NamedTuple):
    """Transport at one bend: radiance at the camera in 1/(mm^2 sr) per unit power.

    Arguments:
        cells: ``(lamp, node, site, facet + 1)``, the last of the untouched pad.
        grain: ``(lamp, node)``: the variance of a cell is about the grain times it; 0 for lamps
            all of whose light has an exit field, whose noise is about 1 % everywhere.
        noise: of colors, relative (`color_noise`), ``()``; the largest of those of the albedos.

    The first two have one more axis ``channel`` where the skin's albedo depends on it.
    """

    cells: Array
    grain: Array
    noise: Array


def transport_at(
    scene: Scene, bend: float, phi: Array, effort: Effort, clock: Clock, seed: int = 0,
    parts: FinishedParts = NOTHING_KEPT,
) -> ConvergedTransport:  # fmt: skip
    """Return transport at one bend, the same for any number of threads.

    While its color noise is above `NOISE_LIMIT`, the photons that fly to the facets are followed
    again with other random numbers, up to `Effort.rounds` times in all, and the mean is taken.

    Arguments:
        scene: the sensor.
        bend: rad in [0, pi], or the number of one of the scene's states.
        phi: ``(node,)`` rad.
        effort: how many paths.
        clock: is ticked, `task_count` times in all; photons that are followed again are added to
            its total.
        seed: of all random numbers.
        parts: where finished pieces of this work are kept, so that it goes on.
    """
    if scene.states is not None:
        effort = replace(effort, arrivals=effort.arrivals // len(scene.state_axis))
        scene, bend = in_state(scene, bend)
    if scene.by_channel and scene.coating.lobe is not None:
        # How much of the light is in the lobe differs, so each channel has light paths of its own.
        of_albedos = [
            transport_at(one, bend, phi, effort, clock, seed, parts.inside(f"albedo-{number}"))
            for number, one in enumerate(scene.one_albedo_scenes)
        ]
        return _by_channel(scene, of_albedos)
    if not scene.window_refracts:
        scene = with_bonded_window(scene)
    sights = None if scene.coating.lobe is None else lines_of_sight(scene, bend)
    paths = _Paths(scene, bend, phi, effort, clock, seed, sights, parts)
    blurs, channels = facet_blurs(scene, bend, ring_count(scene)), len(scene.palette.channels)
    with _threads(paths.stopped) as pool:
        spread = _exit_fields(paths, pool)
        followed = [_arrivals(paths, pool, effort.rounds * seed)]
        pressed, untouched = (
            Gathering(
                scene,
                bend,
                block,
                spread,
                effort.paths,
                clock,
                pool,
                sights,
                seed,
                parts.inside(name),
            )
            for name, block in (("pressed", paths.pressed), ("untouched", paths.untouched))
        )
        facets, rings, spots = pressed.facets(), pressed.rings(), untouched.sites()
        while True:
            arrived = _mean(followed)
            sent = pressed.sent(arrived), untouched.sent(arrived)
            lit = (
                irradiance(facets, field_of(arrived, "facets"), sent[0]),
                irradiance(rings, field_of(arrived, "rings"), sent[0]),
                irradiance(spots, field_of(arrived, "spots"), sent[1]),
            )
            by_albedo = [
                _seen(paths.columns, len(phi), blur, arrived.whole.grain, channels, *each)
                for blur, *each in zip(blurs, *lit, strict=True)
            ]
            noise = max(float(part.noise) for part in by_albedo)
            if noise <= NOISE_LIMIT or len(followed) >= effort.rounds or not flies(scene).any():
                break
            clock.total += _arrival_ticks(scene, effort)
            followed.append(_arrivals(paths, pool, effort.rounds * seed + len(followed)))
    return by_albedo[0] if len(by_albedo) == 1 else _by_channel(scene, by_albedo)


@contextmanager
def _threads(stopped: threading.Event) -> Iterator[ThreadPoolExecutor]:
    """Give one for each processor; at an error or interrupt they drop what waits for them."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            yield pool
        except BaseException:
            stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _by_channel(scene: Scene, parts: list[ConvergedTransport]) -> ConvergedTransport:
    """Return transport with an axis of channels, of that of each albedo."""
    cells, grain = (
        np.stack([each[albedo] for albedo in scene.albedo_of_channel], axis=-1)
        for each in ([part.cells for part in parts], [part.grain for part in parts])
    )
    return ConvergedTransport(cells, grain, np.max([part.noise for part in parts], axis=0))


def _seen(
    columns: list[slice], nodes: int, blur: Array, grain: Array, channels: int,
    facet: Halved[Array], ring: Halved[Array], site: Halved[Array],
) -> ConvergedTransport:  # fmt: skip
    """Return what the camera sees of the irradiance on facets, rings before them and sites."""

    def cells_of(facet: Array, ring: Array, site: Array) -> Array:
        sent = np.concatenate([facet, ring, site[:, None]], axis=1)
        cells = np.einsum("sij,sjr->sir", blur[:, :-1], sent)
        background = blur[:, -1, -1:, None] * site[:, None]
        cells = np.concatenate([cells, background], axis=1)
        out = np.empty((len(columns), nodes, *cells.shape[:2]))
        for lamp, own in enumerate(columns):
            out[lamp] = np.moveaxis(cells[..., own], -1, 0)
        return out

    cells = Halved(*(cells_of(*each) for each in zip(facet, ring, site, strict=True)))
    passed = np.pi * float(np.median(blur[:, :-1].sum(axis=-1)))
    grains = np.zeros((len(columns), nodes))
    for lamp, own in enumerate(columns):
        grains[lamp] = passed * grain[own]
    noise = color_noise(Halved(*(each[..., :-1] for each in cells)), channels)
    return ConvergedTransport(cells.whole, grains, np.array(noise))


class _Paths:
    """What all light paths of a pad at one bend share.

    ``columns`` are those of each lamp in what is made of its light, one for every node, or one for
    all. Once they are ``stopped``, no further batch of photons flies.
    """

    def __init__(
        self, scene: Scene, bend: float, phi: Array, effort: Effort, clock: Clock, seed: int,
        sights: Array | None, parts: FinishedParts,
    ) -> None:  # fmt: skip
        self.parts = parts
        self.scene, self.bend, self.phi, self.effort = scene, bend, phi, effort
        self.clock, self.seed, self.sights = clock, seed, sights
        self.stopped = threading.Event()
        self.untouched = bent_block(scene, bend, pressed=False)
        self.pressed = bent_block(scene, bend, pressed=True)
        self.grid: FaceGrid = face_grid(scene)
        self.nodes = np.where(flat_fiber_poses(scene).turns, len(phi), 1)
        ends = np.cumsum(self.nodes)
        self.columns = [
            slice(int(end - count), int(end)) for end, count in zip(ends, self.nodes, strict=True)
        ]


def _exit_fields(paths: _Paths, pool: ThreadPoolExecutor) -> Halved[Array]:
    """Return the exit field ``(cell * term, column)``; no cells where no lamp has one."""
    scene, grid, spread = paths.scene, paths.grid, spreads(paths.scene)
    rows = cell_count(grid) * term_count(grid) if spread.any() else 0

    def field_of(lamp: int) -> Halved[Array]:
        if not spread[lamp]:
            return Halved(*(np.zeros((rows, paths.nodes[lamp])) for _ in Halved._fields))
        name, ticks = f"field-{lamp}", _field_ticks(paths.effort)
        kept = paths.parts.load(name)
        if kept is not None:
            paths.clock.skip(ticks)
            return Halved(**kept)
        found = exit_field(
            scene, paths.bend, lamp, paths.phi, paths.untouched, grid, paths.effort.photons,
            paths.seed,
        )  # fmt: skip
        field = Halved(*(each.reshape(rows, -1) for each in found))
        paths.parts.save(name, field._asdict())
        paths.clock.tick(ticks)
        return field

    fields = list(pool.map(field_of, range(scene.lamp_count)))
    return Halved(*(np.concatenate(each, axis=1) for each in zip(*fields, strict=True)))


def _arrivals(paths: _Paths, pool: ThreadPoolExecutor, seed: int) -> Halved[Arrivals]:
    """Return what gets to coating and facets by itself; the last axis is the column."""
    scene, flying = paths.scene, flies(paths.scene)
    receivers = receivers_at(scene, paths.bend, paths.sights)

    photons = _photons(scene, paths.effort)
    every, ticks = batches(photons), _batch_ticks(scene, paths.effort)
    sums = [_Sum(paths.parts, f"arrivals-{seed}-{lamp}") for lamp in range(scene.lamp_count)]

    def batch_of(lamp: int, numbers: range) -> Flown:
        if paths.stopped.is_set():
            raise CancelledError
        found = flown(
            scene, paths.bend, lamp, paths.phi, paths.untouched, paths.pressed, receivers,
            photons, numbers, seed,
        )  # fmt: skip
        paths.clock.tick(ticks)
        return found

    # Batches of all lamps, so that no processor waits for the last lamp; summed in their order.
    lit = np.flatnonzero(flying).tolist()
    tasks = [(lamp, numbers) for lamp in lit for numbers in every[sums[lamp].count :]]
    if kept := len(lit) * len(every) - len(tasks):
        paths.clock.skip(ticks * kept)
    found = pool.map(lambda task: batch_of(*task), tasks)
    lamps = []
    for lamp in range(scene.lamp_count):
        if flying[lamp]:
            lamps.append(arrivals(scene, sums[lamp].with_all(found, len(every))))
        else:
            lamps.append(Halved(*(no_arrivals(scene, paths.nodes[lamp]) for _ in Halved._fields)))
    return Halved(
        *(
            Arrivals(*(np.concatenate(parts, axis=-1) for parts in zip(*each, strict=True)))
            for each in zip(*lamps, strict=True)
        )
    )


class _Sum:
    """What batches of a lamp's photons bring together, kept every `SAVE_SECONDS`."""

    def __init__(self, parts: FinishedParts, name: str) -> None:
        self.parts, self.name = parts, name
        kept = parts.load(name) or {}
        self.count = int(kept.pop("count", 0))
        self.total = Flown(**kept) if kept else None

    def with_all(self, batches: Iterator[Flown], count: int) -> Flown:
        """Return the sum of ``count`` batches, of which ``batches`` brings the missing ones."""
        saved = time.monotonic()
        for brought in itertools.islice(batches, count - self.count):
            self.total = brought if self.total is None else self.total + brought
            self.count += 1
            if self.count == count or time.monotonic() - saved > SAVE_SECONDS:
                self.parts.save(self.name, self.total._asdict() | {"count": np.array(self.count)})
                saved = time.monotonic()
        assert self.total is not None  # there is a photon at least
        return self.total


def _mean(followed: list[Halved[Arrivals]]) -> Halved[Arrivals]:
    """Return the mean of photons that were followed with several seeds; a photon is worth less."""
    if len(followed) == 1:
        return followed[0]
    whole, difference = (
        Arrivals(*(np.mean(parts, axis=0) for parts in zip(*each, strict=True)))
        for each in zip(*followed, strict=True)
    )
    return Halved(whole._replace(grain=whole.grain / len(followed)), difference)
