"""A design finds the file of its scene by what it holds, and a run keeps a copy of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from optimize.design import (
    Rating,
    ScoreSettings,
    baseline_design,
    find_scene,
    keep_scene,
    open_rated,
    save_design,
)
from render.errors import SceneError
from render.scene import load_scene, scene_text, standalone

RATING = Rating("preview", 50.0, (40.0, 60.0), 60.0, 5.0, 5.0, ScoreSettings(1.0, 1.0))


@pytest.fixture
def design(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a scene into a file that is not called like it, and the design of a run for it."""
    monkeypatch.chdir(tmp_path)
    text = scene_text("finger20").replace('name = "finger20"', 'name = "mine"')
    Path("rev7.toml").write_text(text.replace("value = 18.0", "value = 17.0"))
    scene = load_scene("rev7.toml")
    save_design(Path("run/design.json"), baseline_design(scene), scene, RATING)
    return Path("run/design.json")


def test_a_scene_file_of_any_name_is_found_by_the_scene_that_it_holds(design: Path) -> None:
    assert open_rated(design).scene.pad.width == 17.0
    assert find_scene("mine", design) == "rev7.toml"


def test_of_two_files_of_one_name_that_with_the_hash_of_the_design_is_taken(design: Path) -> None:
    later = Path("rev7.toml").read_text().replace("value = 17.0", "value = 16.0")
    Path("mine.toml").write_text(later)
    assert find_scene("mine", design) == "mine.toml"
    assert open_rated(design).scene.pad.width == 17.0


def test_a_run_that_went_elsewhere_has_its_scene_with_it(
    design: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep_scene(design.parent, standalone("rev7.toml"))
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    design.parent.rename(moved / "run")
    monkeypatch.chdir(moved)
    assert open_rated(design).scene.name == "mine"
    # What lies in a folder of the run, as the wiring does, has it as well.
    (moved / "run" / "design-wiring").mkdir()
    inner = design.rename(design.parent / "design-wiring" / "mounted.json")
    assert open_rated(inner).scene.name == "mine"


def test_files_beside_it_that_are_no_scenes_are_passed_by(design: Path) -> None:
    Path("broken.toml").write_text("name = [")
    Path("other.toml").write_text('name = "mine"\nschema = 2\n')
    assert open_rated(design).scene.pad.width == 17.0
    Path("rev7.toml").unlink()
    with pytest.raises(SceneError, match=r"other\.toml is not a valid scene"):
        open_rated(design)
