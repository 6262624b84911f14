"""Primary sample space Metropolis chains (Kelemen et al. 2002) over any path sampler.

A *path sampler* maps primary samples to splats: values that are to be averaged into bins. Chains
walk through primary sample space with stationary density proportional to the scalar target
``F(u) = sum over splats of weight[bin, channel] * value``.

The first events of a path are stored per chain and perturbed; the tail of long scattering paths
is hashed from a per-chain seed, which is part of the state and changes on large steps only. The
proposal is symmetric in both parts, so this is exact and memory stays bounded.

Estimates combine large steps, which are plain Monte Carlo samples, with the chains by Kelemen's
balance heuristic (2002, sec. 4.3): a sample is worth ``value / (F / b + p_large)``, where the
normalization constant ``b`` is the mean of ``F``. With ``p_large = 1`` this is plain bidirectional
Monte Carlo.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import drjit as dr
import mitsuba as mi

from render.arrays import Array
from render.sampling.streams import Numbers, Stream, hashed

# Kelemen et al. 2002, sec. 3.1: perturbations between s1 and s2, exponentially distributed.
STEP_SMALL, STEP_LARGE = 1.0 / 1024.0, 1.0 / 64.0
LIGHT_EVENTS = 16384
"""Events by which light subpaths of one chain are apart."""
LIGHT_SALT = 0x7FEB352D
"""Separates the streams of light and camera subpaths."""


@dataclass
class Splat:
    """Values (one per channel) that a path adds to one bin per lane (a Dr.Jit PyTree)."""

    bin: mi.UInt32
    values: list[mi.Float]


@dataclass
class CellSplat:
    """What a path adds to every bin: ``values (bin, channel, lane)``, float64."""

    values: Array


class PathSampler(Protocol):
    """What Monte Carlo and Markov chains sample."""

    bins: int
    channels: int
    stored: tuple[int, int, int]  # camera events, light paths, events stored per light path

    def evaluate(self, camera: Stream, light: Stream) -> list[Splat]:
        """Return the splats of one path per lane."""
        ...


def perturb(value: mi.Float, number: mi.Float) -> mi.Float:
    """Return ``value`` moved by a symmetric exponential step, wrapped into [0, 1)."""
    sign = dr.select(number < 0.5, 1.0, -1.0)
    unit = dr.select(number < 0.5, 2.0 * number, 2.0 * number - 1.0)
    ratio = dr.log(STEP_LARGE / STEP_SMALL)
    moved = value + sign * STEP_LARGE * dr.exp(-ratio * unit)
    moved = moved - dr.floor(moved)
    return dr.select(moved >= 1.0, 0.0, moved)


@dataclass
class Mutation:
    """What a proposal is made of, per chain: its kind, and the seeds of its random numbers.

    ``fresh`` replaces everything on a ``large`` step; ``step`` perturbs the stored numbers on a
    small one; ``tail`` is the current seed of the numbers that are not stored.
    """

    large: mi.Bool
    fresh: mi.UInt32
    step: mi.UInt32
    tail: mi.UInt32

    @staticmethod
    def all_large(seed: mi.UInt32) -> Mutation:
        """Return large steps to the independent paths of a ``seed`` each."""
        # In arrays of their own, so that kernels are those of other steps; only one is read.
        return Mutation(dr.full(mi.Bool, True, dr.width(seed)), seed, seed ^ 1, seed ^ 2)


@dataclass
class MutatedStream:
    """The proposal's primary samples of one kind of subpath, computed on the fly.

    ``memory`` holds four arrays of ``slots * lanes`` numbers; ``block`` is the number of stored
    events of every run of ``stride`` events (a light path), of which there are ``blocks``.
    """

    memory: list[mi.Float]
    lane: mi.UInt32
    lanes: int
    mutation: Mutation
    salt: mi.UInt32 | int
    first: mi.UInt32 | int
    block: mi.UInt32 | int
    blocks: mi.UInt32 | int
    stride: mi.UInt32 | int

    @staticmethod
    def camera(
        memory: list[mi.Float], lane: mi.UInt32, lanes: int, mutation: Mutation, block: int
    ) -> MutatedStream:
        """Return the numbers of camera subpaths, which are one run of events."""
        return MutatedStream(memory, lane, lanes, mutation, 0, 0, block, 1, 1 << 24)

    @staticmethod
    def light(
        memory: list[mi.Float], lane: mi.UInt32, lanes: int, mutation: Mutation, first: int,
        block: int, paths: int,
    ) -> MutatedStream:  # fmt: skip
        """Return the numbers of ``paths`` light subpaths, stored from slot ``first`` on."""
        return MutatedStream(
            memory, lane, lanes, mutation, LIGHT_SALT, first, block, paths, LIGHT_EVENTS
        )

    def event(self, index: mi.UInt32) -> Numbers:
        """Return the four numbers of event ``index``."""
        index = mi.UInt32(index)
        run = index // self.stride
        within = index - run * self.stride
        stored = (within < self.block) & (run < self.blocks)
        slot = self.first + run * self.block + within
        return self._numbers(index, slot, stored)

    def events(self, *indices: mi.UInt32) -> list[Numbers]:
        """Return the numbers of several events."""
        return [self.event(index) for index in indices]

    def of_lanes(self, lane: mi.UInt32) -> MutatedStream:
        """Return the numbers of the chains ``lane``."""
        there = dr.gather(mi.UInt32, self.lane, lane)
        return replace(self, lane=there, mutation=dr.gather(Mutation, self.mutation, lane))

    def unless(self, there: mi.Bool, other: MutatedStream) -> MutatedStream:
        """Return these numbers, but ``other`` ones of the same chains where ``there``."""
        names = ("salt", "first", "block", "blocks", "stride")
        pairs = {n: (mi.UInt32(getattr(other, n)), mi.UInt32(getattr(self, n))) for n in names}
        return replace(self, **{n: dr.select(there, *pair) for n, pair in pairs.items()})

    def slot_numbers(self, slot: mi.UInt32) -> Numbers:
        """Return the numbers of stored slot ``slot`` (counted from ``first``)."""
        run = slot // self.block
        index = run * self.stride + (slot - run * self.block)
        return self._numbers(index, self.first + slot, dr.full(mi.Bool, True, dr.width(slot)))

    def _numbers(self, index: mi.UInt32, slot: mi.UInt32, stored: mi.Bool) -> Numbers:
        mutation = self.mutation
        moving = stored & ~mutation.large
        small = dr.select(stored, mutation.step, mutation.tail)
        seed = dr.select(mutation.large, mutation.fresh, small) ^ self.salt
        where = slot * self.lanes + self.lane
        a, b, c, d = (
            dr.select(moving, perturb(dr.gather(mi.Float, array, where, moving), number), number)
            for array, number in zip(self.memory, hashed((seed, index))[0], strict=True)
        )
        return a, b, c, d
