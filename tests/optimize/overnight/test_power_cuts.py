"""The power is cut at any instant: what goes on ends bit-equal, and nothing finished is lost."""

from __future__ import annotations

import random
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import optimize.overnight.workers
from optimize.overnight.rows import check_rows
from optimize.overnight.run_directory import (
    LOCK,
    LOG,
    RECORD,
    check_run_directory,
    open_record,
    writing,
)
from optimize.overnight.store import RENDERS, STATES
from render.files import TEMPORARY, read_or_drop
from render.folders import leftovers
from render.reference import RenderJob, RenderResult
from tests.long import LONG
from tests.optimize.overnight import replacing
from tests.optimize.overnight.attempt import attempt
from tests.optimize.overnight.commands import NAMES, left_by, words_of
from tests.optimize.overnight.power_cuts import Disk, cuts, versions
from tests.optimize.overnight.recorded_disk import Operation, recorded
from tests.optimize.overnight.tiny import (
    command,
    rows,
    start,
    tiny_scene,
    write_tiny,
)

STATES_OF_A_RUN = 4000 if LONG else 100
STATES_OF_A_RESULT = 2000 if LONG else 50


class RecordedRun:
    """What `attempt` asks of the disk, and what it leaves."""

    def __init__(self, folder: Path) -> None:
        self.scene, self.run = tiny_scene(folder), folder / "run"
        self.run.mkdir()
        words = [sys.executable, "-m", "tests.optimize.overnight.attempt", self.run, folder]
        self.operations = recorded(words, self.run, folder / "strace.txt")
        self.states = versions(self.operations)

    def outcome(self, run: Path) -> list[object]:
        """Return all that a run is for: renders, what is logged of them, decisions."""
        return [
            {path.name: path.read_bytes() for path in (run / RENDERS).iterdir()},
            rows(run, "SELECT DISTINCT key, sha256 FROM evaluations ORDER BY key"),
            rows(run, "SELECT name, value FROM decisions"),
            list((run / STATES).iterdir()),
            [path for path in run.rglob("*") if TEMPORARY.fullmatch(path.name)],
        ]

    def known_render(
        self, job: RenderJob, state: Path, tick: Callable[[int], None]
    ) -> RenderResult:
        """Return what the render of ``job`` is known to be; what is kept of it has to be whole."""
        if read_or_drop(state) is not None:
            assert state.read_bytes() in self.states[f"{STATES}/{state.name}"]
        tick(job.samples)
        with np.load(self.run / RENDERS / f"{job.key}.npz") as arrays:
            return RenderResult(arrays["estimate"], arrays["largest"], 1.0)


@pytest.fixture(scope="module")
def recorded_run(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    return RecordedRun(tmp_path_factory.mktemp("recorded"))


def after_cuts(
    operations: Sequence[Operation], count: int, target: Path, seed: int
) -> Iterator[tuple[int, random.Random]]:
    """Yield ``count`` numbers of operations done, with ``target`` as a cut then leaves it."""
    rng = random.Random(seed)
    instants = [rng.randrange(len(operations) + 1) for _ in range(count)]
    for instant, disk in cuts(operations, instants):
        shutil.rmtree(target, ignore_errors=True)
        disk.write_after_cut(target, rng, None)
        yield instant, rng


def test_a_run_ends_bit_equal_after_a_cut_and_no_render_is_made_twice(
    recorded_run: RecordedRun,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(optimize.overnight.workers, "run_job", recorded_run.known_render)
    run, wanted = tmp_path / "run", recorded_run.outcome(recorded_run.run)
    for instant, _ in after_cuts(recorded_run.operations, STATES_OF_A_RUN, run, 17):
        attempt(run, recorded_run.scene)
        assert recorded_run.outcome(run) == wanted, instant
        assert len(rows(run, "SELECT * FROM evaluations")) == len(wanted[1]), instant
    assert capfd.readouterr().err == ""


def test_the_recording_makes_the_same_files_again(
    recorded_run: RecordedRun, tmp_path: Path
) -> None:
    disk = Disk()
    for operation in recorded_run.operations:
        disk.do(operation)
    disk.write_after_cut(tmp_path / "run", random.Random(0), "nothing")

    def content(run: Path) -> dict[str, bytes]:
        files = [path for path in run.rglob("*") if path.is_file()]
        # SQLite writes the index of its log through memory, and makes it anew.
        return {str(p.relative_to(run)): p.read_bytes() for p in files if p.suffix != "-shm"}

    assert content(tmp_path / "run") == content(recorded_run.run)


def test_what_is_finished_outlasts_a_cut(recorded_run: RecordedRun, tmp_path: Path) -> None:
    disk = Disk()
    for operation in recorded_run.operations:
        disk.do(operation)
    disk.write_after_cut(tmp_path / "run", random.Random(0), "everything")
    # But a state may still be there, which the next attempt takes away.
    *whole, _, _ = recorded_run.outcome(recorded_run.run)
    assert recorded_run.outcome(tmp_path / "run")[: len(whole)] == whole


def test_renders_that_were_never_synced_are_named_and_made_again(
    recorded_run: RecordedRun,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    # A disk that lies: of a program that syncs, this is the only way to damage.
    lied = [
        each
        for each in recorded_run.operations
        if not (each.kind == "sync" and each.path.startswith(RENDERS))
    ]
    monkeypatch.setattr(optimize.overnight.workers, "run_job", recorded_run.known_render)
    run, wanted, damaged = tmp_path / "run", recorded_run.outcome(recorded_run.run), 0
    for instant, _ in after_cuts(lied, STATES_OF_A_RUN // 4, run, 18):
        attempt(run, recorded_run.scene)
        said = capfd.readouterr().err
        assert recorded_run.outcome(run) == wanted, instant
        again = len(rows(run, "SELECT * FROM evaluations")) - len(wanted[1])
        assert said.count("rendered again") == said.count(f"/{RENDERS}/") == again, said
        damaged += again
    assert damaged > STATES_OF_A_RUN // 20


def test_work_in_a_result_that_is_replaced_is_still_there(tmp_path: Path) -> None:
    original, folder = tmp_path / "original", tmp_path / "folder"
    original.mkdir()
    words = [sys.executable, "-m", "tests.optimize.overnight.replacing", original]
    operations = recorded(words, original, tmp_path / "strace.txt")
    target = folder / replacing.RESULT
    rendered = next(
        number
        for number, each in enumerate(operations)
        if each.kind == "sync" and each.path.endswith(replacing.RENDERS)
    )
    for instant, rng in after_cuts(operations, STATES_OF_A_RESULT, folder, 19):
        # What anybody does next: the same again, or something else.
        page = rng.choice(replacing.PAGES)
        replacing.replace(folder, page)
        assert (target / replacing.PAGE).read_bytes() == page
        kept = target / replacing.RENDERS / "pad.npz"
        if instant > rendered + 1 or kept.exists():
            assert kept.read_bytes() == replacing.RENDER, instant
        assert not leftovers(folder), instant


DECISIONS = "SELECT name, value FROM decisions ORDER BY id"
STATES_OF_A_COMMAND, RESUMED = 2000, 5


def check_files(folder: Path, whole: dict[str, set[bytes]], decisions: list[object]) -> None:
    """Check that all under a final name is whole, and that decisions are the first ones made."""
    if decisions and (folder / "out").is_dir():
        check_run_directory(folder / "out")
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if path.is_dir() or any(TEMPORARY.fullmatch(part) for part in path.parts):
            continue
        if path.name == RECORD:
            with writing(path.parent), closing(open_record(path.parent)) as db:
                check_rows(db)
            found = rows(path.parent, DECISIONS)
            assert found == decisions[: len(found)]
        elif not path.name.startswith((LOCK, LOG, RECORD)):
            assert path.read_bytes() in whole[name], name


@pytest.mark.slow
@pytest.mark.skipif(not LONG, reason="part of make validation-long")
def test_nights_and_other_long_commands_end_bit_equal_after_a_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, rng, state = write_tiny(tmp_path), random.Random(3), tmp_path / "cut"
    for name in NAMES:
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / f"cache-{name}"))
        folder = tmp_path / name
        folder.mkdir()
        asked = command(*words_of(name, scene, folder))
        operations = recorded(asked, folder, tmp_path / f"{name}.txt")
        whole, night = versions(operations), folder / "out"
        decisions = rows(night, DECISIONS) if (night / RECORD).exists() else []
        resumed = set(rng.sample(range(STATES_OF_A_COMMAND), RESUMED))
        for number, _ in enumerate(after_cuts(operations, STATES_OF_A_COMMAND, state, 20)):
            check_files(state, whole, decisions)
            if number in resumed:
                process = start(*words_of(name, scene, state))
                said = process.communicate()[1]
                assert process.returncode == 0, said
                assert left_by(name, state) == left_by(name, folder)
