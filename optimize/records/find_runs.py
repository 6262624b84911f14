"""Where the runs of a folder are: folders and files that the commands write, whole or not."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

from optimize.dimensions.study_page import PLAN
from optimize.overnight.result import NIGHT
from optimize.overnight.run_directory import RECORD, RunError
from optimize.records.run_record import (
    VERIFIED,
    RunRecord,
    damaged,
    kind_of_result,
    read_record,
)
from optimize.report import BASELINE, DESIGN, REPORT
from optimize.ui.output import MANIFEST
from render.files import refuse_endless
from render.folders import became, is_busy
from surrogate.runtime.model_file import CARD_FILE, MODEL_FILE, SUM_FILE

MANIFESTS = {MANIFEST, SUM_FILE, RECORD, NIGHT}
"""Whoever has one of these is whole, and nothing of it is to be deleted."""
OWN_FILES = {BASELINE, DESIGN, MODEL_FILE, RECORD}
"""What such a folder holds soon; others may give their hidden folders names of the same form."""
COMPARED = "compare"
"""Begin of the name of the folder for renders of ``compare``, which leaves nothing else behind."""
SKIPPED = ("node_modules", "site-packages", "__pycache__")
PLAY_MARK = b'<script type="application/json" id="page">'
BEGINNING = 200_000
"""Bytes of an HTML file in which the mark of a page to play with stands, style included."""


def find_runs(folder: Path, on_unread: Callable[[OSError], None] | None = None) -> list[RunRecord]:
    """Return all runs in ``folder`` and below, the latest first.

    ``on_unread`` is told of each folder that may not be read.

    Raises:
        RunError: there is no such folder.
    """
    if not folder.is_dir():
        raise RunError(
            f"{folder} is no folder: name the one in which your runs are, or leave it out for the "
            "one that you are in",
            field="folder",
        )
    found = list(_runs(folder, on_unread))
    return sorted(found, key=lambda record: (-record.time, str(record.path)))


def _runs(folder: Path, on_unread: Callable[[OSError], None] | None) -> Iterator[RunRecord]:
    for place, folders, files in os.walk(folder, onerror=on_unread):
        here = Path(place)
        own = _own(here, set(files))
        yield from own
        hidden = (here / name for name in sorted(folders) if became(name))
        yield from (_half_written(path, names) for path in hidden
                    if (names := _names(path)) & OWN_FILES)  # fmt: skip
        # What lies in a night or a model is of that run.
        inside = any(record.kind in ("overnight", "train") for record in own)
        folders[:] = [] if inside else [
            name for name in sorted(folders) if name not in SKIPPED and not name.startswith(".")
        ]  # fmt: skip


def _own(here: Path, files: set[str]) -> list[RunRecord]:
    """Return the runs whose record lies in the folder ``here`` itself."""
    if {RECORD, NIGHT} & files:
        return [read_record("overnight", here)]
    if MODEL_FILE in files:
        return [read_record("train", here)]
    if {CARD_FILE, SUM_FILE} <= files:
        return [damaged("train", here, f"{MODEL_FILE} is missing")]
    found = [read_record("verify", here / name) for name in sorted(files)
             if VERIFIED.fullmatch(name)]  # fmt: skip
    found += _unfinished(here, files)
    kind = kind_of_result(here / MANIFEST) if MANIFEST in files else None
    if kind is not None:
        return [*found, read_record(kind, here)]
    if PLAN in files:
        found.append(_goes_on("study", here, "not all sensors are answered yet"))
    elif {DESIGN, REPORT} <= files:
        found.append(damaged("explore", here, f"{MANIFEST} is missing"))
    pages = sorted(name for name in files if name.endswith((".html", ".htm")))
    return found + [read_record("play", here / name) for name in pages if _to_play(here / name)]


def _to_play(path: Path) -> bool:
    """Return whether ``path`` is a page to play with, whole or cut off."""
    try:
        refuse_endless(path)
        with path.open("rb") as stream:
            return PLAY_MARK in stream.read(BEGINNING)
    except OSError:
        return False


def _unfinished(here: Path, files: set[str]) -> list[RunRecord]:
    """Return the run whose work in progress ``here`` is, where it has not come to its end."""
    stem, _, end = here.resolve().name.rpartition("-")
    beside = here.resolve().with_name(stem) if stem else here
    if end == "training" and "plan.json" in files and not (beside / MODEL_FILE).is_file():
        return [_goes_on("train", here, f"no model in {beside} yet")]
    if end != "renders":
        return []
    rendered = any(name.endswith(".npz") for name in files)
    # Of the design `my.v2.json` the renders are in `my.v2-renders`.
    design = beside.with_name(f"{beside.name}.json")
    if rendered and stem != COMPARED and not design.exists() and not beside.exists():
        return [_goes_on("optimize", here, f"no result in {beside} yet")]
    if any(name.endswith(".state.npz") for name in files):
        return [_goes_on("verify", here, "a render was cut off")]
    return []


def _goes_on(kind: str, path: Path, why: str) -> RunRecord:
    text = f"{why}; the same command goes on from here"
    return RunRecord(
        kind, path, path.stat().st_mtime, "unfinished", note=text[0].upper() + text[1:]
    )


def _names(folder: Path) -> set[str]:
    """Return the names in ``folder``, none where it may not be read."""
    try:
        return {item.name for item in folder.iterdir()}
    except OSError:
        return set()


def _half_written(path: Path, files: set[str]) -> RunRecord:
    """Return the run that was being put together when its process ended, or is just now."""
    kind = "train" if MODEL_FILE in files else "overnight" if RECORD in files else "explore"
    why = "half written: its process was killed, and it can be deleted"
    if files & MANIFESTS:
        why = (
            f"whole, but its process was killed while {became(path.name)} was replaced: keep it, "
            "the same command puts in place what is missing there"
        )
    if is_busy(path):
        why = "half written: a process works in it"
    return RunRecord(kind, path, path.stat().st_mtime, "unfinished", note=why.capitalize())
