"""The disk whose power is cut, against what POSIX says of files, names and their syncs."""

from __future__ import annotations

import random
import shutil
from collections.abc import Sequence
from pathlib import Path

from tests.optimize.overnight.power_cuts import Disk
from tests.optimize.overnight.recorded_disk import Operation

OLD, NEW = b"a" * 8192, b"b" * 8192


def left(operations: Sequence[Operation], target: Path) -> list[dict[str, bytes]]:
    """Return what two hundred cuts after ``operations`` leave, each as content by path."""
    disk, rng, found = Disk(), random.Random(1), []
    for operation in operations:
        disk.do(operation)
    for _ in range(200):
        shutil.rmtree(target, ignore_errors=True)
        disk.write_after_cut(target, rng, None)
        files = [path for path in target.rglob("*") if path.is_file()]
        found.append({path.relative_to(target).as_posix(): path.read_bytes() for path in files})
    return found


def written(path: str, data: bytes) -> list[Operation]:
    return [Operation("create", path), Operation("write", path, 0, data)]


def synced(*paths: str) -> list[Operation]:
    return [Operation("sync", path) for path in paths]


def test_without_a_sync_of_the_folder_a_file_may_have_no_name(tmp_path: Path) -> None:
    found = left([*written("a", OLD), *synced("a")], tmp_path / "disk")
    assert {frozenset(each.items()) for each in found} == {frozenset(), frozenset({("a", OLD)})}


def test_with_both_syncs_it_is_there_whatever_is_cut(tmp_path: Path) -> None:
    found = left([*written("a", OLD), *synced("a", "")], tmp_path / "disk")
    assert all(each == {"a": OLD} for each in found)


def test_a_write_without_a_sync_is_torn_between_sectors_and_never_inside_of_one(
    tmp_path: Path,
) -> None:
    begun = [*written("a", OLD), *synced("a", ""), Operation("write", "a", 0, NEW)]
    found = [each["a"] for each in left(begun, tmp_path / "disk")]
    sectors = {each[at : at + 512] for each in found for at in range(0, 8192, 512)}
    assert sectors == {OLD[:512], NEW[:512]}
    # In any order: late sectors without early ones too.
    assert any(each.startswith(b"a") and each.endswith(b"b") for each in found)
    assert any(each.startswith(b"b") and each.endswith(b"a") for each in found)


def test_a_file_may_have_grown_without_its_content(tmp_path: Path) -> None:
    begun = [Operation("create", "a"), *synced(""), Operation("write", "a", 0, NEW)]
    found = {each["a"] for each in left(begun, tmp_path / "disk")}
    assert {b"", NEW} < found
    assert any(set(each) == {0, ord("b")} for each in found)


def test_a_name_that_is_replaced_is_always_one_of_both(tmp_path: Path) -> None:
    first = [*written("a", OLD), *synced("a", "")]
    second = [*written("new", NEW), *synced("new"), Operation("rename", "new", target="a")]
    found = {each["a"] for each in left([*first, *second], tmp_path / "disk")}
    assert found == {OLD, NEW}


def test_a_rename_into_another_folder_loses_nothing(tmp_path: Path) -> None:
    folders = [Operation("mkdir", "one"), Operation("mkdir", "two"), *synced("")]
    file = [*written("one/a", OLD), *synced("one/a", "one")]
    moved = Operation("rename", "one/a", target="two/a")
    found = {frozenset(each) for each in left([*folders, *file, moved], tmp_path / "disk")}
    assert found == {frozenset({"one/a"}), frozenset({"two/a"}), frozenset({"one/a", "two/a"})}
    # Nor where the sync of its old folder is all that was done.
    found = {
        frozenset(each)
        for each in left([*folders, *file, moved, *synced("one")], tmp_path / "disk")
    }
    assert found == {frozenset({"two/a"})}
