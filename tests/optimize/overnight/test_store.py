"""The record and its files: what is damaged is noticed, what is foreign is left alone."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.overnight.rows import COLUMNS
from optimize.overnight.run_directory import (
    RECORD,
    RunError,
    check_run_directory,
    holder,
    locked,
    writing,
)
from optimize.overnight.status import status_of
from optimize.overnight.store import RENDERS, Request, Store
from optimize.ui.output import OutputError
from render.progress import Progress
from render.reference import RenderJob, RenderResult
from render.scene import Scene
from tests.optimize.overnight.tiny import ROOT, request_of, tiny_jobs, tiny_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return tiny_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def job(scene: Scene) -> RenderJob:
    return tiny_jobs(scene, 1)[0]


@pytest.fixture
def said() -> list[str]:
    return []


class Opener:
    """Opens a run again and again, as one process after the other does."""

    def __init__(self, run: Path, scene: Scene, note: Callable[[str], None]) -> None:
        self.run, self.scene, self.note = run, scene, note
        self.store: Store | None = None

    def __call__(self) -> Store:
        self.close()
        self.store = Store(self.run, request_of(self.scene), self.note)
        return self.store

    def close(self) -> None:
        if self.store is not None:
            self.store.close("stopped")
        self.store = None


@pytest.fixture
def opened(scene: Scene, tmp_path: Path, said: list[str]) -> Iterator[Opener]:
    opener = Opener(tmp_path, scene, said.append)
    yield opener
    opener.close()


@pytest.fixture
def result() -> RenderResult:
    light = np.random.default_rng(0).random((4, 5, 1, 8))
    return RenderResult(light, 0.25 * light.max(axis=0), 1.5)


def contents(run: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}


def file_of(run: Path, job: RenderJob) -> Path:
    return run / RENDERS / f"{job.key}.npz"


def test_a_render_comes_back_bit_equal_with_its_seconds(
    opened: Opener, job: RenderJob, result: RenderResult
) -> None:
    assert opened().finished(job) is None
    opened().keep(job, result, "table", "here")
    kept = opened().finished(job)
    assert kept is not None
    np.testing.assert_array_equal(kept.estimate, result.estimate)
    np.testing.assert_array_equal(kept.largest, result.largest)
    assert kept.seconds == result.seconds


def test_every_render_is_logged_with_its_hash_and_what_it_is_of(
    opened: Opener, job: RenderJob, result: RenderResult, tmp_path: Path, scene: Scene
) -> None:
    opened().keep(job, result, "1/table", "worker 3")
    opened()
    db = sqlite3.connect(tmp_path / RECORD)
    row = db.execute("SELECT key, kind, level, seed, spec, worker FROM evaluations").fetchone()
    db.close()
    assert row[:4] == (job.key, "1/table", "reference", job.seed)
    assert json.loads(row[4])["scene"] == scene.hash
    assert row[5] == "worker 3"


@pytest.mark.parametrize("damage", ["truncated", "bit", "empty", "missing"])
def test_a_damaged_render_is_told_of_and_made_again(
    opened: Opener,
    job: RenderJob,
    result: RenderResult,
    tmp_path: Path,
    said: list[str],
    damage: str,
) -> None:
    opened().keep(job, result, "table", "here")
    path = file_of(tmp_path, job)
    whole = path.read_bytes()
    if damage == "truncated":
        path.write_bytes(whole[: len(whole) // 2])
    elif damage == "bit":
        at = len(whole) // 2
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    elif damage == "empty":
        path.write_bytes(b"")
    else:
        path.unlink()
    store = opened()
    assert store.finished(job) is None
    assert len(said) == 1
    assert path.name in said[0]
    store.keep(job, result, "table", "here")
    assert path.read_bytes() == whole
    store = opened()
    assert store.finished(job) is not None
    assert status_of(tmp_path).evaluations == 1


def test_a_file_that_was_not_logged_is_not_taken(
    opened: Opener, job: RenderJob, result: RenderResult, tmp_path: Path
) -> None:
    opened().keep(job, result, "table", "here")
    other = replace(job, seed=99)
    file_of(tmp_path, other).write_bytes(file_of(tmp_path, job).read_bytes())
    assert opened().finished(other) is None


def test_what_a_killed_process_left_half_written_is_swept_away(
    opened: Opener, job: RenderJob, tmp_path: Path
) -> None:
    opened()
    half = tmp_path / RENDERS / f".{job.key}.npz.{'0' * 32}"
    half.write_bytes(b"half")
    own = tmp_path / ".note-of-mine"
    own.write_text("mine")
    opened()
    assert not half.exists()
    assert own.exists()


def test_a_decision_is_made_once(opened: Opener) -> None:
    made = []

    def choose() -> dict[str, float]:
        made.append(1)
        return {"samples": 0.1 + 0.2}

    assert opened().decide("1/plan", choose) == {"samples": 0.1 + 0.2}
    assert opened().decide("1/plan", choose) == {"samples": 0.1 + 0.2}
    assert len(made) == 1


def test_time_is_that_of_all_attempts_and_does_not_follow_the_clock_on_the_wall(
    opened: Opener, monkeypatch: pytest.MonkeyPatch
) -> None:
    import time

    real = time.time
    monkeypatch.setattr(time, "time", lambda: real() + 86400.0)
    first = opened().spent()
    monkeypatch.setattr(time, "time", lambda: real() - 86400.0)
    second = opened().spent()
    assert 0 <= first < second < 60


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"the scene of hash": "0" * 16}, "the scene of hash"),
        ({"constraints of hash": "x"}, "without constraints of hash, asked for is one with constr"),
        ({"--seed": 5}, "with --seed 0, asked for is one with --seed 5"),
        ({"--samples": None}, "with --samples 8, asked for is one without --samples"),
    ],
)
def test_a_run_of_something_else_is_refused_and_left_alone(
    opened: Opener, scene: Scene, tmp_path: Path, change: Request, words: str
) -> None:
    opened()
    opened.close()
    before = contents(tmp_path)
    with pytest.raises(RunError, match=words):
        Store(tmp_path, request_of(scene) | change, print)
    assert contents(tmp_path) == before


def test_a_run_of_another_version_is_refused(opened: Opener, tmp_path: Path, scene: Scene) -> None:
    opened()
    db = sqlite3.connect(tmp_path / RECORD)
    db.execute("UPDATE meta SET value = '99' WHERE name = 'schema'")
    db.commit()
    db.close()
    with pytest.raises(RunError, match="version 99 of the format, this program reads version 7"):
        Store(tmp_path, request_of(scene), print)
    with pytest.raises(RunError, match="version 99"):
        status_of(tmp_path)


@pytest.mark.parametrize("damage", ["text", "hole", "cut"])
def test_a_damaged_record_is_one_sentence_and_nothing_is_destroyed(
    opened: Opener, job: RenderJob, result: RenderResult, tmp_path: Path, scene: Scene, damage: str
) -> None:
    store = opened()
    for seed in range(60):
        store.keep(replace(job, seed=seed), result, "table", "here")
    opened.close()
    path = tmp_path / RECORD
    content = path.read_bytes()
    hole = len(content) // 2
    path.write_bytes(
        {
            "text": b"these are not the tables you are looking for" * 100,
            "hole": content[:4096] + b"\xff" * hole + content[4096 + hole :],
            "cut": content[: len(content) // 3],
        }[damage]
    )
    before = path.read_bytes()
    with (
        pytest.raises(RunError, match=r"run\.sqlite is damaged .* nothing was changed"),
        writing(tmp_path),
    ):
        Store(tmp_path, request_of(scene), print)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE decisions SET value = '[1,3]'",
        "UPDATE evaluations SET seconds = 2.5",
        "UPDATE attempts SET seconds = 7.0",
        "UPDATE meta SET value = '{\"--seed\": 1}' WHERE name = 'request'",
        "UPDATE meta SET value = '{x' WHERE name = 'request'",
        "UPDATE progress SET done = 0.5",
        "DROP TABLE progress; CREATE VIEW progress AS WITH RECURSIVE n(i) AS "
        "(SELECT 1 UNION ALL SELECT i FROM n) SELECT i AS stage FROM n WHERE i = 2",
        "DROP TABLE meta; CREATE VIEW meta AS WITH RECURSIVE n(i) AS "
        "(SELECT 1 UNION ALL SELECT i FROM n) SELECT i AS name, i AS value FROM n WHERE i = 2",
        "CREATE TRIGGER t AFTER INSERT ON attempts BEGIN DELETE FROM decisions; END",
    ],
)
def test_a_row_that_is_not_as_it_was_written_is_named_and_never_read(
    opened: Opener, job: RenderJob, result: RenderResult, tmp_path: Path, scene: Scene, change: str
) -> None:
    store = opened()
    store.keep(job, result, "table", "here")
    store.decide("1/plan", lambda: [1, 2])
    store.progress("Table", Progress(1, 2), None)
    opened.close()
    assert status_of(tmp_path).share == 0.5
    with closing(sqlite3.connect(tmp_path / RECORD)) as db:
        db.executescript(change)
    with pytest.raises(RunError, match=r"run\.sqlite is damaged"):
        status_of(tmp_path)
    with pytest.raises(RunError, match=r"run\.sqlite is damaged"), writing(tmp_path):
        Store(tmp_path, request_of(scene), print)


def test_no_bit_of_a_record_turns_and_changes_what_is_read(
    opened: Opener, job: RenderJob, result: RenderResult, tmp_path: Path
) -> None:
    store = opened()
    for seed in range(8):
        store.keep(replace(job, seed=seed), result, "table", "here")
        store.decide(f"{seed}/plan", lambda: {"samples": 8, "phi": [0.25, 1.5]})
    opened.close()
    path = tmp_path / RECORD
    content, whole = path.read_bytes(), all_rows(tmp_path)
    rng, text = np.random.default_rng(0), b'{"samples": 8, "phi": [0.25, 1.5]}'
    inside = 8 * content.index(text) + rng.integers(0, 8 * len(text), 40)
    anywhere = rng.integers(0, 8 * len(content), 80)
    for bit in (*inside.tolist(), *anywhere.tolist()):
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        try:
            status_of(tmp_path)
        except RunError:
            continue
        # Of bits that nobody reads, as in pages that are not full.
        assert bit not in inside
        assert all_rows(tmp_path) == whole


def all_rows(run: Path) -> list[object]:
    with closing(sqlite3.connect(run / RECORD)) as db:
        return [db.execute(f"SELECT * FROM {name}").fetchall() for name in COLUMNS]


def test_a_first_moment_that_was_killed_is_gone_on_from(tmp_path: Path, scene: Scene) -> None:
    killed = "import os, signal; os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
    killed += HOLD
    done = subprocess.run([sys.executable, "-c", killed, str(tmp_path)], cwd=ROOT, check=False)
    assert done.returncode == -signal.SIGKILL
    assert any(path.name.startswith(f".{RECORD}.") for path in tmp_path.iterdir())
    check_run_directory(tmp_path)
    Store(tmp_path, request_of(scene), print).close("stopped")
    assert not any(path.name.startswith(f".{RECORD}.") for path in tmp_path.iterdir())


@pytest.mark.parametrize("name", ["lock", RECORD + "-wal", RECORD + "-journal"])
def test_a_pipe_in_a_run_directory_hangs_nobody(
    opened: Opener, tmp_path: Path, scene: Scene, name: str
) -> None:
    opened()
    opened.close()
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    if name == "lock":
        assert status_of(tmp_path).holder is None
        with pytest.raises(RunError, match="it is a pipe"), writing(tmp_path), locked(tmp_path):
            pass
    else:
        with pytest.raises(RunError, match="it is a pipe"):
            status_of(tmp_path)


def test_a_directory_that_holds_something_else_is_left_alone(tmp_path: Path) -> None:
    check_run_directory(tmp_path / "new")
    check_run_directory(tmp_path)
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputError, match="holds files but no earlier result"):
        check_run_directory(tmp_path)
    with pytest.raises(OutputError, match="is not a directory"):
        check_run_directory(tmp_path / "thesis.tex")
    with pytest.raises(RunError, match="holds no run"):
        status_of(tmp_path)


def test_a_reader_never_meets_a_record_without_its_tables(
    tmp_path: Path, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = []

    class Watched(sqlite3.Connection):
        """Lets another process look at the run after every statement."""

        def look(self) -> None:
            if (tmp_path / RECORD).exists():
                monkeypatch.undo()
                looks.append(status_of(tmp_path).evaluations)
                monkeypatch.setattr("optimize.overnight.store.sqlite3.connect", watched)

        def execute(self, *words: Any) -> sqlite3.Cursor:
            done = super().execute(*words)
            self.look()
            return done

        def executescript(self, *words: Any) -> sqlite3.Cursor:
            done = super().executescript(*words)
            self.look()
            return done

    watched = partial(sqlite3.connect, factory=Watched)
    monkeypatch.setattr("optimize.overnight.store.sqlite3.connect", watched)
    store = Store(tmp_path, request_of(scene), print)
    store.close("stopped")
    assert len(looks) > 3
    assert not any(looks)


def test_a_record_that_has_no_room_leaves_nothing(
    tmp_path: Path, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Full(sqlite3.Connection):
        def commit(self) -> None:
            raise sqlite3.OperationalError("database or disk is full")

    connect = partial(sqlite3.connect, factory=Full)
    monkeypatch.setattr("optimize.overnight.store.sqlite3.connect", connect)
    with pytest.raises(sqlite3.OperationalError):
        Store(tmp_path, request_of(scene), print)
    assert not list(tmp_path.iterdir())


def test_a_database_of_something_else_is_refused(tmp_path: Path, scene: Scene) -> None:
    (tmp_path / RECORD).touch()
    with pytest.raises(RunError, match="is not the record of a run"):
        status_of(tmp_path)
    with pytest.raises(RunError, match="is not the record of a run"):
        Store(tmp_path, request_of(scene), print)


HOLD = """
import sys, pathlib
from optimize.overnight.run_directory import locked
from optimize.overnight.store import Store
run = pathlib.Path(sys.argv[1])
with locked(run):
    Store(run, {}, print)
    print("held", flush=True)
    sys.stdin.readline()
"""


def test_the_second_process_refuses_and_names_the_first_even_when_that_was_killed_later(
    tmp_path: Path,
) -> None:
    first = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip
    assert first.stdout is not None
    assert first.stdin is not None
    try:
        assert first.stdout.readline() == "held\n"
        with (
            pytest.raises(RunError, match=f"in use by process {first.pid} on "),
            locked(tmp_path),
        ):
            pass
        assert f"process {first.pid}" in str(holder(tmp_path))
    finally:
        os.kill(first.pid, signal.SIGKILL)
        first.wait()
        first.stdin.close()
        first.stdout.close()
    assert holder(tmp_path) is None
    with locked(tmp_path):
        assert holder(tmp_path) is not None
