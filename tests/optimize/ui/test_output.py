"""Result directories appear whole or not at all, and never swallow somebody else's files."""

from __future__ import annotations

from pathlib import Path

import pytest

from optimize.ui.output import OutputError, check_target, fresh_directory, write_manifest


def write_result(target: Path, content: str) -> None:
    with fresh_directory(target) as folder:
        (folder / "report.html").write_text(content)
        write_manifest(folder, {"seconds": 1.0})


def names(folder: Path) -> set[str]:
    return {item.name for item in folder.iterdir()}


def test_a_new_result_appears_complete_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    write_result(tmp_path / "runs" / "a", "first")
    assert names(tmp_path / "runs") == {"a"}
    assert names(tmp_path / "runs" / "a") == {"report.html", "result.json"}


def test_an_error_leaves_the_earlier_result_as_it_was(tmp_path: Path) -> None:
    write_result(tmp_path / "a", "first")

    def fail_half_way() -> None:
        with fresh_directory(tmp_path / "a") as folder:
            (folder / "report.html").write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_half_way()
    assert (tmp_path / "a" / "report.html").read_text() == "first"
    assert names(tmp_path) == {"a"}


def test_a_later_result_replaces_the_earlier_one_but_keeps_what_others_put_there(
    tmp_path: Path,
) -> None:
    write_result(tmp_path / "a", "first")
    (tmp_path / "a" / "verify-0123").mkdir()
    (tmp_path / "a" / "verify-0123" / "chain.npz").write_bytes(b"hours of work")
    write_result(tmp_path / "a", "second")
    assert (tmp_path / "a" / "report.html").read_text() == "second"
    assert (tmp_path / "a" / "verify-0123" / "chain.npz").read_bytes() == b"hours of work"
    assert names(tmp_path) == {"a"}


def test_a_file_that_the_later_result_no_longer_has_goes_away(tmp_path: Path) -> None:
    with fresh_directory(tmp_path / "a") as folder:
        (folder / "old.png").write_bytes(b"")
        write_manifest(folder, {})
    write_result(tmp_path / "a", "second")
    assert names(tmp_path / "a") == {"report.html", "result.json"}


def test_a_directory_with_other_files_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(OutputError, match="left alone"):
        check_target(tmp_path)


def test_a_file_in_the_way_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("")
    with pytest.raises(OutputError, match="not a directory"):
        check_target(tmp_path / "a")
    with pytest.raises(OutputError, match="not a writable directory"):
        check_target(tmp_path / "a" / "b")
