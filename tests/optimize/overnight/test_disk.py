"""Full, closed and damaged disks: one sentence, nothing lost, and the run goes on afterwards."""

from __future__ import annotations

import os
import resource
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

import render.reference.job
from optimize.overnight.run_directory import RECORD
from optimize.overnight.store import RENDERS
from render.scene import Scene, load_scene
from tests.optimize.overnight.attempt import attempt
from tests.optimize.overnight.tiny import ROOT, command, tiny_scene

pytestmark = pytest.mark.slow

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}
ATTEMPT = f"{sys.executable} -m tests.optimize.overnight.attempt"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the scene and a run that nothing disturbed."""
    folder = tmp_path_factory.mktemp("disk")
    (folder / "unbroken").mkdir()
    finish(folder / "unbroken", tiny_scene(folder))
    return folder


def finish(run: Path, scene: Scene) -> None:
    """Begin a run, or go on with it, in this process and to its end."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(render.reference.job, "SAVE_SECONDS", 0.0)
        attempt(run, scene)


def renders(run: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (run / RENDERS).iterdir()}


def flipped(content: bytes, at: int) -> bytes:
    return content[:at] + bytes([content[at] ^ 4]) + content[at + 1 :]


def finished(run: Path) -> int:
    db = sqlite3.connect(run / RECORD)
    (count,) = db.execute("SELECT COUNT(DISTINCT key) FROM evaluations").fetchone()
    db.close()
    return int(count)


def in_namespace(script: str) -> subprocess.CompletedProcess[str]:
    """Run a shell script that may mount file systems nobody else sees."""
    if subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode:
        pytest.skip("this system lets nobody mount a file system of his own")
    return subprocess.run(
        ["unshare", "-rm", "sh", "-ec", script],
        cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True,
    )  # fmt: skip


def test_a_full_disk_is_one_sentence_and_with_space_the_run_ends_bit_equal(
    folder: Path, tmp_path: Path
) -> None:
    run, kept = tmp_path / "mounted", tmp_path / "kept"
    run.mkdir()
    done = in_namespace(
        f"""
        mount -t tmpfs -o size=4m tmpfs {run}
        {ATTEMPT} {run} {folder} &
        until [ "$(ls {run}/{RENDERS} 2>/dev/null | wc -l)" -ge 2 ]; do sleep 0.1; done
        cat /dev/zero > {run}/ballast 2>/dev/null || true
        wait $! && exit 9 || echo code $?
        rm {run}/ballast
        cp -r {run} {kept}
        {ATTEMPT} {run} {folder}
        cp -r {run} {kept}-after
        """
    )
    assert done.returncode == 0, done.stderr
    sentence, code = done.stdout.splitlines()
    assert code == "code 2"
    assert "free some space, then give the same command again" in sentence
    before, wanted = finished(kept), renders(folder / "unbroken")
    assert 0 < before < len(wanted)
    after = Path(f"{kept}-after")
    assert renders(after) == wanted
    assert finished(after) == len(wanted)


@pytest.mark.parametrize("most", [30_000, 40_000])
def test_files_that_may_not_grow_are_one_sentence_too(
    folder: Path, tmp_path: Path, most: int
) -> None:
    # The record cannot be begun, or not be gone on with.
    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    stopped = subprocess.run(
        [*ATTEMPT.split(), str(tmp_path), str(folder)], preexec_fn=limited,
        cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True,
    )  # fmt: skip
    assert stopped.returncode == 2, stopped.stderr
    assert "goes on from what is" in stopped.stdout
    assert stopped.stdout.count("\n") == 1
    finish(tmp_path, load_scene(folder / "tiny.toml"))
    assert renders(tmp_path) == renders(folder / "unbroken")


def test_a_read_only_directory_is_one_sentence_and_status_still_reads_it(
    folder: Path, tmp_path: Path
) -> None:
    run = tmp_path / "mounted"
    run.mkdir()
    again = " ".join(command("overnight", folder / "tiny.toml", "--out", run, "--samples", 8))
    status = " ".join(command("status", run))
    done = in_namespace(
        f"""
        mount -t tmpfs -o size=20m tmpfs {run}
        cp -r {folder / "unbroken"}/. {run}
        mount -o remount,ro {run}
        {status}
        {again} 2>&1 && exit 9 || echo code $?
        """
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert "was stopped" in lines[0]
    assert lines[-1] == "code 2"
    assert "cannot be written (Read-only file system): choose another place" in lines[-2]


def test_a_directory_that_is_taken_away_meanwhile_is_one_sentence(
    folder: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    script = f"""
        {ATTEMPT} {run} {folder} &
        until [ "$(ls {run}/{RENDERS} 2>/dev/null | wc -l)" -ge 1 ]; do sleep 0.1; done
        mv {run} {run}-elsewhere
        wait $! && exit 9 || echo code $?
        """
    done = subprocess.run(
        ["sh", "-ec", script], cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True
    )
    sentence, code = done.stdout.splitlines()
    assert "was taken away" in sentence
    assert code == "code 2"
    # Nothing was lost: put back, it ends as if nothing had happened.
    shutil.rmtree(run, ignore_errors=True)
    (tmp_path / "run-elsewhere").rename(run)
    finish(run, load_scene(folder / "tiny.toml"))
    assert renders(run) == renders(folder / "unbroken")


@pytest.mark.parametrize("damage", ["truncated", "flipped"])
def test_a_damaged_render_is_named_and_only_that_one_is_made_again(
    folder: Path, tmp_path: Path, damage: str, capfd: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    shutil.copytree(folder / "unbroken", run)
    path = sorted((run / RENDERS).iterdir())[3]
    whole = path.read_bytes()
    broken = whole[:-100] if damage == "truncated" else flipped(whole, 500)
    path.write_bytes(broken)
    finish(run, load_scene(folder / "tiny.toml"))
    said = capfd.readouterr().err
    assert path.name in said
    assert said.count("rendered again") == 1
    assert renders(run) == renders(folder / "unbroken")
    db = sqlite3.connect(run / RECORD)
    logged = db.execute("SELECT key FROM evaluations").fetchall()
    db.close()
    assert len(logged) == len(renders(run)) + 1
