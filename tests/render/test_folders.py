"""A folder takes the place of another one, and a kill at any instant loses neither."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from render import files, folders

MANIFEST = "manifest"
ROOT = Path(__file__).parents[2]
DYING = """
import fcntl, os, signal, sys
from pathlib import Path
from render import files, folders

calls = iter(range(1, 99))
def dying(change):
    def called(*words, **more):
        if next(calls) == int(sys.argv[2]):
            os.kill(os.getpid(), signal.SIGKILL)
        return change(*words, **more)
    return called
target = Path(sys.argv[1])
"""
REPLACE = """
with folders.fresh_folder(target) as fresh:
    (fresh / "file").write_text("second")
    (fresh / "manifest").write_text("")
    for name in ("rename", "unlink", "rmdir"):
        setattr(os, name, dying(getattr(os, name)))
    folders.replace_folder(fresh, target, lambda old: folders.remove_folder(old, "manifest"))
"""


BEGIN = """
os.mkdir, os.rmdir = dying(os.mkdir), dying(os.rmdir)
fcntl.flock = dying(fcntl.flock)
files.can_create(target)
with folders.fresh_folder(target):
    pass
"""


def write(target: Path, text: str) -> None:
    with folders.fresh_folder(target) as fresh:
        (fresh / "file").write_text(text)
        (fresh / MANIFEST).write_text("")
        folders.replace_folder(fresh, target, remove)


def remove(old: Path) -> None:
    folders.remove_folder(old, MANIFEST)


def test_a_folder_takes_the_place_of_another_which_is_settled(tmp_path: Path) -> None:
    target, seen = tmp_path / "a", []
    write(target, "first")
    with folders.fresh_folder(target) as fresh:
        (fresh / "file").write_text("second")
        folders.replace_folder(fresh, target, lambda old: seen.append((old / "file").read_text()))
    assert (target / "file").read_text() == "second"
    assert seen == ["first"]


def test_an_error_between_puts_the_earlier_folder_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target, rename = tmp_path / "a", os.rename
    write(target, "first")

    def fail(source: Path, to: Path) -> None:
        if "a" in folders.became(Path(source).name) and Path(to) == target:
            monkeypatch.setattr(os, "rename", rename)
            raise OSError("no")
        rename(source, to)

    monkeypatch.setattr(os, "rename", fail)
    with pytest.raises(OSError, match="no"):
        write(target, "second")
    assert (target / "file").read_text() == "first"
    assert {path.name for path in tmp_path.iterdir()} == {"a"}


@pytest.mark.parametrize("instant", range(1, 9))
def test_a_kill_at_any_instant_leaves_a_whole_folder_to_be_found(
    tmp_path: Path, instant: int
) -> None:
    target = tmp_path / "a"
    write(target, "first")
    done = subprocess.run(
        [sys.executable, "-c", DYING + REPLACE, str(target), str(instant)], cwd=ROOT, check=False
    )
    assert done.returncode in (0, -signal.SIGKILL)
    folders.put_back(target, MANIFEST, remove)
    assert (target / "file").read_text() in ("first", "second")
    assert (target / MANIFEST).is_file()
    assert {path.name for path in tmp_path.iterdir()} == {"a"}


@pytest.mark.parametrize("instant", range(1, 7))
def test_a_kill_before_anything_is_written_leaves_nothing_of_others(
    tmp_path: Path, instant: int
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", DYING + BEGIN, str(tmp_path / "a"), str(instant)],
        cwd=ROOT, check=False,
    )  # fmt: skip
    assert done.returncode == -signal.SIGKILL
    assert not folders.foreign_names(tmp_path)
    folders.put_back(tmp_path / "a", MANIFEST, remove)
    assert not list(tmp_path.iterdir())


def test_a_new_folder_is_never_taken_for_a_leftover_of_another_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target, make = tmp_path / "a", Path.mkdir
    others: list[threading.Thread] = []

    def slowly(path: Path, *words: Any, **more: Any) -> None:
        make(path, *words, **more)
        if folders.became(path.name):
            mend = threading.Thread(target=folders.put_back, args=(target, MANIFEST, remove))
            mend.start()
            mend.join(0.3)
            others.append(mend)

    monkeypatch.setattr(Path, "mkdir", slowly)
    with folders.fresh_folder(target) as fresh:
        others[0].join()
        assert fresh.is_dir()


def test_a_folder_that_a_process_works_in_is_left_to_it(tmp_path: Path) -> None:
    target = tmp_path / "a"
    with folders.fresh_folder(target) as fresh:
        (fresh / "file").write_text("half")
        folders.put_back(target, MANIFEST, remove)
        assert folders.is_busy(fresh)
        assert (fresh / "file").read_text() == "half"
    assert not list(tmp_path.iterdir())


def test_leftovers_are_no_files_of_others(tmp_path: Path) -> None:
    hexadecimal = "0" * 32
    for name in (f".run.sqlite.{hexadecimal}", f".run.sqlite.{hexadecimal}-journal", ".mine"):
        files.write_text(tmp_path / name, "")
    assert folders.foreign_names(tmp_path) == {".mine"}
