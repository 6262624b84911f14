"""What a test asks the disk for: syncs and renames in their order."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

DURABLE = ["sync file", "rename", "sync folder"]
"""A file that outlasts a loss of power: its content first, then its name."""


def logged_disk(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that grows by the syncs of files and folders and by the renames of files."""
    log: list[str] = []
    fsync, replace = os.fsync, os.replace

    def logged_fsync(handle: int) -> None:
        log.append("sync folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "sync file")
        fsync(handle)

    def logged_replace(source: Path, target: Path) -> None:
        log.append("rename")
        replace(source, target)

    monkeypatch.setattr(os, "fsync", logged_fsync)
    monkeypatch.setattr(os, "replace", logged_replace)
    return log
