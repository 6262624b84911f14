"""What a disk may hold after its power was cut: any legal part of what was not synced.

The rules are POSIX's and no file system's own, as in Pillai et al., "All file systems are not
created equal" (OSDI 2014): content outlasts a cut from the sync of its file on, a name from the
sync of its folder on. Of writes that were not synced every sector may be there or not, whatever
their order; a file may have grown without its content. Of changes of names any part may be there;
a rename into another folder may leave both names, not neither, as where it is one transaction of a
journal. Writes inside of a sector do not tear it, and touch no other.
"""

from __future__ import annotations

import os
import random
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tests.optimize.overnight.recorded_disk import Operation

SECTORS = (512, 4096)
LOSSES = ("nothing", "everything", "the latest", "any part")
"""What of a file's or a folder's changes is lost."""


@dataclass
class _File:
    """Content on the disk, and the changes since its last sync, each ``(offset, data or size)``."""

    durable: bytes = b""
    changes: list[tuple[int, bytes | None]] = field(default_factory=list)
    newest: bytearray = field(default_factory=bytearray)

    def change(self, at: int, data: bytes | None) -> None:
        at = len(self.newest) if at < 0 else at
        self.changes.append((at, data))
        _apply(self.newest, at, data)

    def sync(self) -> None:
        self.durable, self.changes = bytes(self.newest), []

    def after_cut(self, rng: random.Random, loss: str) -> bytes:
        if loss == "nothing" or not self.changes:
            return bytes(self.newest)
        if loss == "everything":
            return self.durable
        count = rng.randrange(len(self.changes) + 1)
        between = bytearray(self.durable)
        for at, data in self.changes[:count]:
            _apply(between, at, data)
        if loss == "the latest":
            return bytes(between)
        versions = [self.durable, bytes(between), bytes(self.newest)]
        size, sector = len(rng.choice(versions)), rng.choice(SECTORS)
        parts = []
        for at in range(0, size, sector):
            part = rng.choice(versions)[at : at + sector]
            parts.append(part.ljust(min(sector, size - at), b"\0"))
        return b"".join(parts)


Names = dict[str, "_File | _Folder | None"]
"""A change of names; None takes one away."""


@dataclass(eq=False)
class _Move:
    """What a rename adds to another folder, and whether this cut has kept it, once it is drawn."""

    into: _Folder
    added: Names
    kept: bool | None = None

    @property
    def pending(self) -> bool:
        return any(change is self.added for change, _ in self.into.changes)


@dataclass(eq=False)
class _Folder:
    """Names on the disk, and the changes since its last sync, with the move that they belong to."""

    durable: dict[str, _File | _Folder] = field(default_factory=dict)
    changes: list[tuple[Names, _Move | None]] = field(default_factory=list)
    newest: dict[str, _File | _Folder] = field(default_factory=dict)

    def change(self, names: Names, move: _Move | None = None) -> None:
        self.changes.append((names, move))
        _rename(self.newest, names)

    def sync(self) -> None:
        for _, move in self.changes:
            if move is not None and move.into is not self and move.pending:
                # What is taken away here for good is there for good.
                _rename(move.into.durable, move.added)
        self.durable, self.changes = dict(self.newest), []

    def after_cut(self, rng: random.Random, loss: str) -> dict[str, _File | _Folder]:
        count = rng.randrange(len(self.changes) + 1)
        names = dict(self.durable)
        for number, (change, move) in enumerate(self.changes):
            kept = {
                "nothing": True,
                "everything": False,
                "the latest": number < count,
                "any part": rng.random() < 0.5,
            }[loss]
            if move is not None and move.into is self:
                kept = move.kept = kept if move.kept is None else move.kept or kept
            elif move is not None and kept and move.pending:
                kept = move.kept = move.kept is not False
            if kept:
                _rename(names, change)
        return names


def _apply(content: bytearray, at: int, data: bytes | None) -> None:
    """Write ``data``, or cut the content off ``at``."""
    if data is None:
        del content[at:]
    if len(content) < at:
        content.extend(bytes(at - len(content)))
    if data is not None:
        content[at : at + len(data)] = data


def _rename(names: dict[str, _File | _Folder], changes: Names) -> None:
    for name, item in changes.items():
        names.pop(name, None)
        if item is not None:
            names[name] = item


class Disk:
    """A folder on a disk whose power may be cut between any two operations."""

    def __init__(self) -> None:
        self.root = _Folder()
        self.moves: list[_Move] = []

    def do(self, operation: Operation) -> None:
        """Take an operation in."""
        folder, name = self._place(operation.path)
        item = self.root if not operation.path else folder.newest.get(name)
        if operation.kind in ("create", "mkdir"):
            if item is None:
                folder.change({name: _File() if operation.kind == "create" else _Folder()})
        elif operation.kind == "sync":
            assert item is not None, operation.path
            item.sync()
        elif operation.kind == "unlink":
            folder.change({name: None})
        elif operation.kind == "rename":
            assert item is not None, operation.path
            other, new = self._place(operation.target)
            if other is folder:
                folder.change({name: None, new: item})
            else:
                move = _Move(other, {new: item})
                self.moves.append(move)
                other.change(move.added, move)
                folder.change({name: None}, move)
        else:
            assert isinstance(item, _File), operation
            item.change(operation.at, operation.data if operation.kind == "write" else None)

    def _place(self, path: str) -> tuple[_Folder, str]:
        folder, (*above, name) = self.root, path.split("/")
        for part in above:
            inner = folder.newest[part]
            assert isinstance(inner, _Folder)
            folder = inner
        return folder, name

    def write_after_cut(self, target: Path, rng: random.Random, loss: str | None) -> None:
        """Write what is left after a cut into the folder ``target``; without ``loss`` any part."""
        for move in self.moves:
            move.kept = None
        self._write(self.root, target, rng, loss)

    def _write(self, folder: _Folder, target: Path, rng: random.Random, loss: str | None) -> None:
        target.mkdir()
        for name, item in folder.after_cut(rng, loss or rng.choice(LOSSES)).items():
            if isinstance(item, _Folder):
                self._write(item, target / name, rng, loss)
            else:
                left = item.after_cut(rng, loss or rng.choice(LOSSES))
                (target / name).write_bytes(left)


def cuts(operations: Sequence[Operation], instants: Iterable[int]) -> Iterator[tuple[int, Disk]]:
    """Yield the disk before the operations of these numbers, in their order."""
    disk, done = Disk(), 0
    for instant in sorted(instants):
        for operation in operations[done:instant]:
            disk.do(operation)
        done = instant
        yield instant, disk


def versions(operations: Sequence[Operation]) -> dict[str, set[bytes]]:
    """Return the contents that every file has had whole under its name: after renames, at the end.

    Of a file that is written under its own name these are all states between two writes.
    """
    disk, found = Disk(), dict[str, set[bytes]]()
    for operation in operations:
        disk.do(operation)
        if operation.kind == "rename":
            folder, name = disk._place(operation.target)
            _gather(folder.newest[name], operation.target, found)
    _gather(disk.root, "", found)
    return found


def _gather(item: _File | _Folder, path: str, found: dict[str, set[bytes]]) -> None:
    if isinstance(item, _File):
        found.setdefault(path, set()).add(bytes(item.newest))
        return
    for name, inner in item.newest.items():
        _gather(inner, os.path.join(path, name), found)
