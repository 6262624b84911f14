"""A list of runs as one HTML file that needs nothing else, and as rows for programs."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from datetime import datetime
from itertools import groupby
from pathlib import Path
from typing import Any
from urllib.parse import quote

from optimize.design import Design, find_scene
from optimize.objectives import ERROR_KEYS, READERS, title_of
from optimize.records.run_record import RunRecord
from optimize.report import data_uri, render_page
from optimize.ui.console import counted
from optimize.ui.output import write_result
from render.geometry import fiber_edges
from render.scene import OFF, Scene, load_scene
from render.sensor_drawing import sensor_svg

BAD = ("damaged", "lost", "failed", "unfinished", "stopped")


def record_to_json(record: RunRecord) -> dict[str, object]:
    """Return a run as programs are told it; null is what its record does not say."""
    paths = {name: getattr(record, name) for name in ("design", "report", "play")}
    return {
        "kind": record.kind,
        "path": str(record.path),
        "state": record.state,
        "time": _when(record).isoformat(timespec="seconds"),
        "scene": record.scene or None,
        "scene_hash": record.scene_hash or None,
        "level": record.level or None,
        "effort": record.effort,
        "score": record.score,
        "interval": None if record.interval is None else list(record.interval),
        **{f"{key}_deg": record.errors.get(reader) for reader, key in ERROR_KEYS.items()},
        **{name: None if path is None else str(path) for name, path in paths.items()},
        "note": record.note,
    }


def when_text(record: RunRecord) -> str:
    """Return when a record was written, here."""
    return f"{_when(record):%Y-%m-%d %H:%M}"


def score_text(record: RunRecord) -> tuple[str, str]:
    """Return score and interval as text, empty where the record has none."""
    score = "" if record.score is None else f"{record.score:.1f}"
    ends = record.interval
    return score, "" if ends is None else f"{ends[0]:.1f} to {ends[1]:.1f}"


def degrees_text(record: RunRecord) -> list[str]:
    """Return what each of `READERS` misses, empty where the record does not say."""
    return [f"{record.errors[name]:.2f}°" if name in record.errors else "" for name in READERS]


def write_runs_page(path: Path, folder: Path, records: Sequence[RunRecord]) -> None:
    """Write the list of ``records`` in ``folder`` to ``path``; links lead from there."""
    write_result(path, runs_page(path, folder, records).encode())


def runs_page(path: Path, folder: Path, records: Sequence[RunRecord]) -> str:
    """Return the page as HTML with every picture inside, a group per scene, the latest first."""
    order: dict[str, int] = {}
    for record in records:
        order.setdefault(record.scene_hash, len(order))
    grouped = sorted(records, key=lambda record: order[record.scene_hash])
    drawn = _Drawings()
    groups = []
    for scene_hash, group in groupby(grouped, key=lambda record: record.scene_hash):
        members = list(group)
        rows = [_row(record, path, folder, drawn) for record in members]
        title = members[0].scene if scene_hash else "Scene not known"
        groups.append({"title": title, "scene_hash": scene_hash, "runs": rows})
    wrong = sum(record.state in BAD for record in records)
    summary = f"{counted(len(records), 'run')}, {f'{wrong} not' if wrong else 'all'} complete"
    context = {
        "scene": folder.resolve().name,
        "bends": (),
        "made": datetime.now().astimezone().strftime("%d %B %Y, %H:%M"),
        "summary": summary,
        "groups": groups,
        "steps": _steps(folder, path, records),
    }
    return render_page("runs.html.j2", context)


def color_letters(design: Design, scene: Scene | None = None) -> str:
    """Return the color of every lamp as its first letter, an edge of ``scene`` after the other.

    A name is written out where another one begins like it; – is a lamp that is off.
    """
    first = [name[0] for name in design.palette.names]
    short = {
        name: name[0].upper() if first.count(name[0]) == 1 else f"{name} "
        for name in design.palette.names
    } | {OFF: "–"}
    letters = [short.get(name, f"{name} ") for name in design.color_names]
    edges = [""] * len(letters) if scene is None else fiber_edges(scene)
    pairs = groupby(zip(edges, letters, strict=True), key=lambda pair: pair[0])
    parts = [(edge, "".join(letter for _, letter in rest).strip()) for edge, rest in pairs]
    return ", ".join(f"{edge} {text}".strip() for edge, text in parts)


class _Drawings:
    """Draws the lamps of designs whose scene is found, each once."""

    def __init__(self) -> None:
        self.scenes: dict[tuple[str, str], Scene | None] = {}

    def scene(self, record: RunRecord) -> Scene | None:
        """Return the scene that a record names, where its file is found and has the hash."""
        place = record.path if record.path.is_dir() else record.path.parent
        named = None
        if record.scene:
            named = find_scene(record.scene, place / "design", record.scene_hash)
        key = named or "", record.scene_hash
        if key not in self.scenes:
            try:
                found = load_scene(named) if named else None
            except Exception:  # of a stranger's file; the run is listed without a drawing
                found = None
            self.scenes[key] = (
                found if found is not None and found.hash == record.scene_hash else None
            )
        return self.scenes[key]

    def picture(self, record: RunRecord, scene: Scene | None) -> str:
        """Return the drawing of a run's lamps as a link that holds it, empty without one."""
        design = record.lights
        if design is None or scene is None or len(design.phi) != scene.lamp_count:
            return ""
        inks = [scene.palette.ink(color) for color in design.color_names]
        return data_uri(sensor_svg(scene, design.phi, inks, section=False, dark=True).encode())


def _row(record: RunRecord, page: Path, folder: Path, drawn: _Drawings) -> dict[str, Any]:
    scene = drawn.scene(record)
    picture = drawn.picture(record, scene)
    score, interval = score_text(record)
    fits = record.lights is not None and scene is not None
    fits = fits and len(record.lights.phi) == scene.lamp_count  # type: ignore[union-attr]
    why = "No design" if record.lights is None else "Its scene file is not here"
    links = {"design": record.design, "page to play with": record.play}
    return {
        "name": _name(record.path, folder),
        "kind": record.kind,
        "state": record.state,
        "bad": record.state in BAD,
        "date": _when(record).strftime("%d %B %Y, %H:%M"),
        "level": record.level_name,
        "degrees": [
            (title_of(name), text)
            for name, text in zip(READERS, degrees_text(record), strict=True)
            if text
        ],
        "score": score,
        "interval": interval,
        "note": record.note,
        "picture": picture,
        "no_picture": "" if picture else why,
        "letters": color_letters(record.lights, scene if fits else None) if record.lights else "",
        "report": None if record.report is None else _link(record.report, page),
        "links": [(name, _link(path, page)) for name, path in links.items() if path is not None],
    }


def _when(record: RunRecord) -> datetime:
    return datetime.fromtimestamp(record.time).astimezone()


def _name(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix() if path != folder else folder.resolve().name


def _link(target: Path, page: Path) -> str:
    """Return where ``target`` lies from the page."""
    return quote(Path(os.path.relpath(target.resolve(), page.resolve().parent)).as_posix())


def _steps(folder: Path, path: Path, records: Sequence[RunRecord]) -> list[tuple[str, str]]:
    """Return what to do with runs: compare the latest designs of one scene, list them again."""
    again = ("List the runs again:", _command("runs", folder, "--out", path))
    rated = [r for r in records if r.design and r.kind in ("explore", "optimize", "overnight")]
    for record in rated:
        alike = [other.path for other in rated if other.scene_hash == record.scene_hash]
        if len(alike) > 1:
            return [("See two designs side by side:", _command("compare", *alike[:2])), again]
    for record in rated:
        assert record.design is not None
        if record.level != "reference":
            text = "Let renders decide whether the latest design is better than the baseline:"
            return [(text, _command("verify", record.design)), again]
    return [again] if rated else [("Find a design:", "tactilux explore"), again]


def _command(*words: object) -> str:
    return shlex.join(["tactilux", *map(str, words)])
