"""What a program asks of a folder's disk, in order, as strace sees it: SQLite's writes included."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

CALLS = (
    "openat", "read", "write", "pwrite64", "lseek", "fsync", "fdatasync", "ftruncate", "mkdir",
    "mkdirat", "rename", "renameat", "renameat2", "unlink", "unlinkat", "rmdir",
)  # fmt: skip
UNSEEN = (
    "open", "creat", "pwritev", "pwritev2", "writev", "truncate", "link", "linkat", "symlink",
    "symlinkat", "sendfile", "copy_file_range", "fallocate",
)  # fmt: skip
"""Calls that change files too and are not replayed: none may be of the folder."""
CALL = re.compile(r"(?:\d+ +)?(\w+)\((.*)\) += (-?\d+|0x[0-9a-f]+)(<[^>]*>)?(?: \w+ .*)?$")
PARTED = re.compile(r"(\d+) +(?:(.*)<unfinished \.\.\.>|<\.\.\. \w+ resumed>(.*))$")
WORD = re.compile(r'"((?:\\x[0-9a-f]{2})*)"|[^,\s<>]+(?:<((?:\\x[0-9a-f]{2})*)>)?(?:\(deleted\))?')


@dataclass(frozen=True)
class Operation:
    """One change of a folder's content, by paths below it.

    Arguments:
        kind: ``create``, ``write``, ``truncate``, ``sync``, ``rename``, ``unlink`` or ``mkdir``.
        path: of what is changed; of the folder itself "".
        at: offset of a write, or the size after a truncation.
        data: what is written.
        target: the new path of what is renamed.
    """

    kind: str
    path: str
    at: int = 0
    data: bytes = b""
    target: str = ""


def recorded(command: Sequence[object], folder: Path, log: Path) -> list[Operation]:
    """Return what ``command`` does in ``folder``; ``log`` is a file that strace writes."""
    trial = ["strace", "-o", os.devnull, "true"]
    if not shutil.which("strace") or subprocess.run(trial, capture_output=True).returncode:
        pytest.skip("this system has no strace, or lets nobody trace a process")
    words = [
        "strace", "--follow-forks", "--seccomp-bpf", "--quiet=all", "--strings-in-hex=all",
        "--decode-fds=path", "--string-limit=1000000000", "--signal=none", "--raw=read",
        f"--output={log}",
        f"--trace={','.join(CALLS + UNSEEN)}",
    ]  # fmt: skip
    done = subprocess.run(
        [*words, *map(str, command)], env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return list(operations(log, folder.resolve()))


def operations(log: Path, folder: Path) -> Iterator[Operation]:
    """Yield the operations in a log of strace that are of ``folder``."""
    inside, offsets, appending = f"{folder}", dict[str, int](), set[str]()
    for line in _whole_lines(log):
        found = CALL.match(line)
        if found is None or found[3].startswith("-"):
            continue
        name, result = found[1], int(found[3], 0)
        if name == "read":  # printed raw: only how far it went counts
            handle = str(int(found[2].split(",")[0], 0))
            if handle in offsets:
                offsets[handle] += result
            continue
        words = [*WORD.finditer(found[2])]
        texts = [_text(word[1] if word[2] is None else word[2]) for word in words]
        paths = _paths(name, words, texts)
        mine = [path for path in paths if path == inside or path.startswith(f"{inside}/")]
        if not mine:
            continue
        assert name not in UNSEEN, f"{name} of {mine[0]} cannot be replayed"
        handle = words[0][0].split("<")[0]
        path = mine[0][len(inside) + 1 :]
        if words[0][0].endswith("(deleted)"):
            continue
        if name == "openat":
            flags = words[2][0]
            handle = str(result)
            offsets[handle] = 0
            appending.discard(handle)
            if "O_APPEND" in flags:
                appending.add(handle)
            if "O_CREAT" in flags:
                yield Operation("create", path)
            if "O_TRUNC" in flags:
                yield Operation("truncate", path)
        elif name == "lseek":
            offsets[handle] = result
        elif name == "write":
            at = -1 if handle in appending else offsets.get(handle, 0)
            yield Operation("write", path, at, _bytes(words[1][1])[:result])
            offsets[handle] = offsets.get(handle, 0) + result
        elif name == "pwrite64":
            yield Operation("write", path, int(words[3][0]), _bytes(words[1][1])[:result])
        elif name in ("fsync", "fdatasync"):
            yield Operation("sync", path)
        elif name == "ftruncate":
            yield Operation("truncate", path, int(words[1][0]))
        elif name.startswith("mkdir"):
            yield Operation("mkdir", path)
        elif name.startswith("rename"):
            assert len(mine) == 2, f"{paths} leave the folder"
            yield Operation("rename", path, target=mine[1][len(inside) + 1 :])
        else:
            yield Operation("unlink", path)


def _whole_lines(log: Path) -> Iterator[str]:
    """Yield the calls; strace writes one in two parts when another thread calls meanwhile."""
    begun: dict[str, str] = {}
    with log.open(encoding="ascii") as stream:
        for line in stream:
            parted = PARTED.match(line)
            if parted is None:
                yield line.rstrip("\n")
            elif parted[2] is not None:
                begun[parted[1]] = f"{parted[1]} {parted[2]}"
            elif parted[1] in begun:
                yield begun.pop(parted[1]) + parted[3]


def _paths(name: str, words: list[re.Match[str]], texts: list[str]) -> list[str]:
    """Return the absolute paths that a call names."""
    if name in ("rename", "mkdir", "unlink", "rmdir", "open", "creat", "truncate", "link"):
        return texts[: 2 if name in ("rename", "link") else 1]
    if name in ("openat", "mkdirat", "unlinkat"):
        return [os.path.join(texts[0], texts[1])]
    if name in ("renameat", "renameat2", "linkat"):
        return [os.path.join(texts[0], texts[1]), os.path.join(texts[2], texts[3])]
    return texts[:1]


def _bytes(word: str) -> bytes:
    return bytes.fromhex((word or "").replace("\\x", ""))


def _text(word: str | None) -> str:
    return os.fsdecode(_bytes(word or ""))
