"""A run is listed for what its own command wrote; what others left is none of ours."""

from __future__ import annotations

from pathlib import Path

import pytest

from optimize.dimensions import PLAN
from optimize.records import find_runs
from optimize.report import BASELINE, DESIGN
from render.files import temporary_name
from surrogate.runtime.model_file import MODEL_FILE


def write(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()


def listed(folder: Path) -> dict[str, tuple[str, str]]:
    """Return kind and state of every run, by its path in ``folder``."""
    return {str(run.path.relative_to(folder)): (run.kind, run.state) for run in find_runs(folder)}


def test_renders_of_a_comparison_are_no_optimization(tmp_path: Path) -> None:
    write(tmp_path / "compare-renders" / "seed1.npz")
    assert listed(tmp_path) == {}
    write(tmp_path / "digit-optimize-renders" / "seed1.npz")
    assert listed(tmp_path) == {"digit-optimize-renders": ("optimize", "unfinished")}


@pytest.mark.parametrize("name", ["my", "my.v2", "my.json"])
def test_renders_beside_their_design_are_done_whatever_its_name(name: str, tmp_path: Path) -> None:
    write(tmp_path / f"{name}-renders" / "seed1.npz")
    assert list(listed(tmp_path)) == [f"{name}-renders"]
    write(tmp_path / f"{name}.json")
    assert listed(tmp_path) == {}


@pytest.mark.parametrize("file", ["", "bin", "result.json", "report.html"])
@pytest.mark.parametrize("end", ["disabled", "0123456789abcdef0123456789abcdef"])
def test_a_hidden_folder_of_others_is_not_called_ours(tmp_path: Path, end: str, file: str) -> None:
    folder = tmp_path / f".venv.{end}"
    folder.mkdir()
    if file:
        write(folder / file)
    assert listed(tmp_path) == {}


@pytest.mark.parametrize(
    ("file", "kind"), [(BASELINE, "explore"), (DESIGN, "explore"), (MODEL_FILE, "train")]
)
def test_a_result_that_was_being_put_together_is_half_written(
    tmp_path: Path, file: str, kind: str
) -> None:
    place = temporary_name(tmp_path / "digit")
    write(place / file)
    # Of another form, so of others.
    write(tmp_path / ".digit.backup" / file)
    assert listed(tmp_path) == {place.name: (kind, "unfinished")}


def test_a_hidden_folder_that_may_not_be_read_is_none_of_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(temporary_name(tmp_path / "digit") / DESIGN)

    def refuse(path: Path) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "iterdir", refuse)
    assert listed(tmp_path) == {}


def test_a_study_whose_sensors_are_not_all_answered_goes_on(tmp_path: Path) -> None:
    write(tmp_path / "digit-pad-thickness" / PLAN)
    assert listed(tmp_path) == {"digit-pad-thickness": ("study", "unfinished")}
