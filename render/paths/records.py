"""Records of vertices in memory, where other lanes read them.

A record is a dataclass of arrays, Mitsuba's structures and records (a Dr.Jit PyTree).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import is_dataclass
from itertools import count
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.sampling.reservoirs import Reservoir

GATHERS_WORDS = "X86_V4" in np.show_config(mode="dicts")["SIMD Extensions"]["found"]
"""Whether records are loaded word by word, as processors with AVX-512 gather by themselves.

Loads of four words are followed by a transposition, for which LLVM takes an eighth of the time of
a small picture; without such gathers it would take a third more for words.
"""
SLOT_BITS = 4
"""Of the number of a slot: eight reservoirs of a lane fit into one word."""


def allocated(record: Any, size: int) -> Any:
    """Return uninitialized arrays of ``size``, shaped like ``record``.

    ``dr.empty`` of a dataclass keeps the array types of the variant that was set first.
    """
    return _rebuilt(record, lambda kind: dr.empty(kind, size))


class PackedRecords:
    """Records as rows of 32-bit words, which a dozen loads fetch instead of forty."""

    def __init__(self, like: Any, size: int, constant: tuple[str, ...] = ()) -> None:
        """Make room for ``size`` records; fields named ``constant`` are always those of ``like``.

        All flags are in the first word, if there are any, every other number in one of its own.
        """
        self.like, self.constant = like, constant
        flagged = [type(x) is mi.Bool for x in _leaves(like, constant)]
        self.flags = any(flagged)
        self.loads = -(-(flagged.count(False) + self.flags) // 4)
        self.rows = dr.empty(mi.UInt32, 4 * self.loads * size)

    @staticmethod
    def of(records: Any) -> PackedRecords:
        """Return ``records`` as they are, evaluated."""
        size = dr.width(records)
        packed = PackedRecords(records, size)
        packed.write(records, dr.arange(mi.UInt32, size))
        dr.eval(packed.rows)
        return packed

    def write(self, records: Any, index: mi.UInt32, active: mi.Bool | bool = True) -> None:
        """Write one of the ``records`` per lane to its own ``index``; loops may do so, too."""
        leaves, flags = _leaves(records, self.constant), mi.UInt32(0)
        for k, flag in enumerate(x for x in leaves if type(x) is mi.Bool):
            flags |= dr.select(flag, mi.UInt32(1 << k), 0)
        numbers = [x for x in leaves if type(x) is not mi.Bool]
        words = [dr.reinterpret_array(mi.UInt32, x) for x in numbers]
        write_row(self.rows, [flags, *words] if self.flags else words, index, active)

    def gather(self, index: mi.UInt32, active: mi.Bool | bool = True) -> Any:
        """Return the records at ``index``."""
        row = self.loads * index
        with dr.scoped_set_flag(dr.JitFlag.PacketOps, not GATHERS_WORDS):
            fetched = [
                dr.gather(mi.Vector4u, self.rows, row + i, active) for i in range(self.loads)
            ]
        numbers, bits = (word for load in fetched for word in load), count()
        flags = next(numbers) if self.flags else mi.UInt32(0)

        def leaf(kind: Any) -> Any:
            if kind is mi.Bool:
                return (flags & (1 << next(bits))) != 0
            return dr.reinterpret_array(kind, next(numbers))

        return _rebuilt(self.like, leaf, self.constant)


class DrawnRecords:
    """What reservoirs of each lane have drawn, as rows: loops carry numbers of slots instead.

    A lane has one slot more than reservoirs, so one is always free for what comes next.
    """

    def __init__(
        self, like: Any, lanes: int, reservoirs: int, constant: tuple[str, ...] = ()
    ) -> None:
        """Make room for records like ``like`` (``PackedRecords``)."""
        self.slots = reservoirs + 1
        self.packed = PackedRecords(like, self.slots * lanes, constant)
        self.first = self.slots * dr.arange(mi.UInt32, lanes)
        self.nothing = [Reservoir.holding(mi.UInt32(0)) for _ in range(reservoirs)]

    def updated(
        self, drawn: list[Reservoir], record: Any, weights: list[mi.Float], numbers: list[mi.Float]
    ) -> list[Reservoir]:
        """Return reservoirs of slots that have been offered ``record``, each with its weight."""
        taken = mi.UInt32(0)
        for reservoir in drawn:
            taken |= mi.UInt32(1) << reservoir.item
        free = dr.tzcnt(~taken)
        after = [
            reservoir.update(free, weight, number)
            for reservoir, weight, number in zip(drawn, weights, numbers, strict=True)
        ]
        kept = mi.Bool(False)
        for reservoir in after:
            kept |= reservoir.item == free
        self.packed.write(record, self.first + free, kept)
        return after

    def keep(self, drawn: list[Reservoir], draws: list[mi.Float]) -> None:
        """Evaluate what was drawn in the end; ``draws`` of the same records share them.

        The ``table`` has in which slots that is, in one word, and how many each stands for.
        """
        words, lanes = [mi.UInt32(0)], dr.width(self.first)
        for k, (one, n) in enumerate(zip(drawn, draws, strict=True)):
            words[0] |= one.item << (SLOT_BITS * k)
            words.append(dr.reinterpret_array(mi.UInt32, one.contribution_weight(draws=n)))
        self.size = -(-len(words) // 4) * 4
        self.table = dr.empty(mi.UInt32, self.size * lanes)
        write_row(self.table, words, dr.arange(mi.UInt32, lanes))
        dr.eval(self.table, self.packed.rows)

    def drawn(self, lane: mi.UInt32, k: mi.UInt32) -> tuple[mi.UInt32, mi.Float]:
        """Return the row of what the ``k``-th reservoir of ``lane`` has drawn.

        And how many it stands for, 0 where there is none.
        """
        place = self.size * lane
        items, weight = (dr.gather(mi.UInt32, self.table, i) for i in (place, place + 1 + k))
        item = (items >> (SLOT_BITS * k)) & ((1 << SLOT_BITS) - 1)
        return self.slots * lane + item, dr.reinterpret_array(mi.Float, weight)


def write_row(rows: Any, words: list[Any], index: mi.UInt32, active: mi.Bool | bool = True) -> None:
    """Write ``words`` to row ``index``, whose length is a multiple of four.

    One by one: the transposition that Dr.Jit puts before vectors takes LLVM longer to compile.
    """
    first = -(-len(words) // 4) * 4 * index
    for i, word in enumerate(words):
        # Said to be apart, all of them are written by one kernel.
        dr.scatter(rows, word, first + i, active, mode=dr.ReduceMode.NoConflicts)


def _parts(tree: Any) -> list[tuple[Any, Any]] | None:
    """Return the names and parts of a dataclass, Mitsuba structure or vector; None of a leaf."""
    if is_dataclass(tree):
        return list(vars(tree).items())
    if hasattr(type(tree), "DRJIT_STRUCT"):
        return [(name, getattr(tree, name)) for name in type(tree).DRJIT_STRUCT]
    return list(enumerate(tree)) if dr.depth_v(tree) > 1 else None


def _leaves(tree: Any, left_out: tuple[str, ...] = ()) -> list[Any]:
    """Return the arrays of a tree, in order, without those of parts that are ``left_out``."""
    parts = _parts(tree)
    if parts is None:
        return [tree]
    return [x for name, part in parts if name not in left_out for x in _leaves(part, left_out)]


def _rebuilt(tree: Any, leaf: Callable[[Any], Any], constant: tuple[str, ...] = ()) -> Any:
    """Return a tree like ``tree`` whose arrays of a kind are what ``leaf`` returns, in order.

    Parts named ``constant`` are its own.
    """
    parts, kind = _parts(tree), type(tree)
    if parts is None:
        return leaf(kind)
    built = [
        (name, part if name in constant else _rebuilt(part, leaf, constant)) for name, part in parts
    ]
    if is_dataclass(tree):
        return kind(**dict(built))
    if hasattr(kind, "DRJIT_STRUCT"):
        whole = kind()
        for name, part in built:
            setattr(whole, name, part)
        return whole
    return kind(*(part for _, part in built))
