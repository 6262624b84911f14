"""Records that hold something else are told of in the words of the house."""

from __future__ import annotations

import json
import os
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from optimize.design import baseline_design, save_design
from optimize.records import find_runs
from optimize.records.run_record import read_record
from optimize.ui.output import fresh_directory, write_manifest
from render.scene import load_scene
from tests.wrong_values import FOREIGN, WRONG, Place, changed, places

SCENE = load_scene("gelsight-mini")
VERIFIED: dict[str, Any] = {
    "design": {"score": 90.5, "interval": [88.0, 92.0]},
    "difference": {"value": 3.5, "interval": [1.0, 6.0]},
    "converged": True,
    "samples": 16384,
    "seeds": [1, 2],
}
"""Every key of the record of a verification that is read."""
PAGE: dict[str, Any] = {
    "scene": {"name": "finger20", "hash": "0" * 16},
    "level": "surrogate",
    "halfWidth": 0.8,
    "designs": {},
    "scores": {"start": 90.0},
}
"""What a page to play with begins with."""


def told(folder: Path, kind: str, content: dict[str, Any]) -> str:
    """Return what is said of a run whose record has some content."""
    text = json.dumps(content)
    path = folder / ("verified-0123456789ab.json" if kind == "verify" else "page.html")
    if kind == "play":
        text = f'<script type="application/json" id="page">{text}</script>'
    path.write_text(text)
    return read_record(kind, path).note


@pytest.mark.parametrize(("kind", "content"), [("verify", VERIFIED), ("play", PAGE)])
def test_no_wrong_value_is_told_in_words_of_the_library(
    tmp_path: Path, kind: str, content: dict[str, Any]
) -> None:
    assert "is damaged" not in told(tmp_path, kind, content)
    for place in places(content):
        notes = [told(tmp_path, kind, changed(content, place, value)) for value in WRONG]
        damaged = [note for note in notes if "is damaged (" in note]
        assert len(damaged) > 4, place
        for note in damaged:
            assert str(place[0]) in note
            assert not [words for words in FOREIGN if words in note], (place, note)


@pytest.mark.parametrize(
    ("place", "value", "note"),
    [
        (("design", "score"), "much", 'design.score = "much", allowed: a number'),
        (("design", "interval"), [1.0], "[1.0], allowed: a list of at least 2 items"),
        (("seeds", 1), 2.5, "seeds[1] = 2.5, allowed: a whole number"),
        (("converged",), 3, "converged = 3, allowed: true or false"),
        (("difference",), [], "difference = [], allowed: a table"),
    ],
)
def test_it_names_the_key_the_value_and_what_is_right(
    tmp_path: Path, place: Place, value: object, note: str
) -> None:
    assert note in told(tmp_path, "verify", changed(VERIFIED, place, value))


@pytest.mark.parametrize(
    ("kept", "said"),
    [
        ({"level": "preview"}, "preview"),
        ({"level": "converged preview"}, "surrogate (converged)"),
        ({"level": "surrogate"}, "surrogate"),
        ({"level": "surrogate", "effort": "table"}, "surrogate (table)"),
    ],
)
def test_pages_of_before_are_read_with_their_effort(
    tmp_path: Path, kept: dict[str, str], said: str
) -> None:
    text = json.dumps(PAGE | kept)
    path = tmp_path / "page.html"
    path.write_text(f'<script type="application/json" id="page">{text}</script>')
    record = read_record("play", path)
    assert (record.state, record.level_name) == ("finished", said)


@pytest.mark.parametrize(("content", "note"), [(b"", "it is empty"), (b"{", "it is not JSON")])
def test_a_record_that_holds_nothing_is_told_so(tmp_path: Path, content: bytes, note: str) -> None:
    path = tmp_path / "verified-0123456789ab.json"
    path.write_bytes(content)
    assert note in read_record("verify", path).note


def test_one_hostile_folder_hangs_and_ends_the_list_of_the_others_never(tmp_path: Path) -> None:
    for name, file in (("a", "result.json"), ("b", "night.npz"), ("c", "checker.onnx")):
        (tmp_path / name).mkdir()
        os.mkfifo(tmp_path / name / file)
    (tmp_path / "a" / "design.json").touch()
    os.mkfifo(tmp_path / "page.html")
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "result.json").write_text("[" * 100_000)
    (tmp_path / "deep" / "design.json").touch()
    (tmp_path / "view").mkdir()
    with closing(sqlite3.connect(tmp_path / "view" / "run.sqlite")) as db:
        db.execute(
            "CREATE VIEW meta AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n) "
            "SELECT i AS name, i AS value FROM n WHERE i = 2"
        )
    os.mkfifo(tmp_path / "view" / "lock")
    found = {record.path.name: record for record in find_runs(tmp_path)}
    assert {record.state for record in found.values()} == {"damaged"}
    assert set(found) == {"a", "b", "c", "deep", "view"}
    assert "it holds the view meta" in found["view"].note
    assert "it is a pipe, no file" in found["c"].note


def test_what_a_reader_of_records_did_not_think_of_is_damage_of_that_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "night.npz").touch()

    def fail(_: Path) -> None:
        raise LookupError("no such thing")

    monkeypatch.setattr("optimize.records.run_record._night", fail)
    (record,) = find_runs(tmp_path)
    assert (record.state, record.note) == (
        "damaged",
        "it cannot be read (LookupError: no such thing)",
    )


def test_a_file_that_was_changed_after_it_was_written_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "a"
    with fresh_directory(folder) as work:
        save_design(work / "design.json", baseline_design(SCENE), SCENE)
        (work / "report.html").write_text("whole")
        write_manifest(work, {"scene_hash": SCENE.hash, "optimized": {}})
    (record,) = find_runs(tmp_path)
    assert (record.state, record.note) == ("finished", "")
    (folder / "report.html").write_text("whale")
    (record,) = find_runs(tmp_path)
    assert record.note == "Not as written: report.html"
