"""Result directories appear whole or not at all, and never swallow somebody else's files."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from optimize.records import find_runs
from optimize.ui.output import OutputError, check_target, fresh_directory, write_manifest

ROOT = Path(__file__).parents[3]


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


def write_design(target: Path, angle: float, score: float) -> None:
    with fresh_directory(target, keep="design.json") as folder:
        design = {"scene_hash": "ab", "angles_deg": [angle], "power": [[1.0, 0.0, 0.0]]}
        (folder / "design.json").write_text(json.dumps({**design, "score": score}))
        write_manifest(folder, {})


def test_a_result_with_another_design_is_kept_beside_the_new_one_and_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for angle in (10.0, 20.0, 30.0):
        write_design(tmp_path / "a", angle, 1.0)
        (tmp_path / "a" / "checkpoint").write_text(f"renders of {angle:g}")
    assert names(tmp_path) == {"a", "a-1", "a-2"}
    assert json.loads((tmp_path / "a" / "design.json").read_text())["angles_deg"] == [30.0]
    assert json.loads((tmp_path / "a-1" / "design.json").read_text())["angles_deg"] == [10.0]
    assert (tmp_path / "a-2" / "checkpoint").read_text() == "renders of 20"
    said = capsys.readouterr().err.splitlines()
    kept = [f"The earlier result, another design, is kept in {tmp_path / f'a-{n}'}" for n in (1, 2)]
    assert said == kept


def test_the_same_design_rated_anew_replaces_the_earlier_result(tmp_path: Path) -> None:
    write_design(tmp_path / "a", 10.0, 1.0)
    write_design(tmp_path / "a", 10.0, 2.0)
    assert names(tmp_path) == {"a"}
    assert json.loads((tmp_path / "a" / "design.json").read_text())["score"] == 2.0


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


KILLED = """
import os, signal, sys
from pathlib import Path
from optimize.ui.output import fresh_directory, write_manifest

rename, calls = os.rename, iter(range(1, 99))
def dying(*words, **more):
    if next(calls) == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)
    return rename(*words, **more)
os.rename = dying
with fresh_directory(Path(sys.argv[1])) as folder:
    (folder / "report.html").write_text("second")
    write_manifest(folder, {})
"""


@pytest.mark.parametrize("instant", range(1, 5))
def test_a_kill_at_any_rename_loses_neither_a_result_nor_renders_in_it(
    tmp_path: Path, instant: int
) -> None:
    target = tmp_path / "a"
    write_result(target, "first")
    for name in ("design-renders", "notes"):
        (target / name).mkdir()
        (target / name / "chain.npz").write_bytes(b"hours of work")
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(target), str(instant)], cwd=ROOT, check=False
    )
    assert done.returncode == -signal.SIGKILL
    kept = [record for record in find_runs(tmp_path) if "deleted" in record.note]
    assert not kept
    write_result(target, "third")
    assert (target / "report.html").read_text() == "third"
    for name in ("design-renders", "notes"):
        assert (target / name / "chain.npz").read_bytes() == b"hours of work"
    assert names(tmp_path) == {"a"}


def test_what_a_killed_process_left_is_no_file_of_others(tmp_path: Path) -> None:
    (tmp_path / f".report.html.{'0' * 32}").write_text("half")
    check_target(tmp_path)


@pytest.mark.parametrize("place", ["", ".", "..", "/"])
def test_a_place_without_a_name_of_its_own_is_refused_before_any_work(place: str) -> None:
    with pytest.raises(OutputError, match="cannot be replaced from within"):
        check_target(Path(place))
