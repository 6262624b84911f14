"""Model folders appear whole, or not at all."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from render.errors import ModelError
from render.scene import Scene
from surrogate.export import package
from surrogate.export.package import FILES, write_package
from surrogate.model.checker_module import CheckerModule
from surrogate.model.preview_grid import PreviewGrid
from surrogate.runtime.model_file import MODEL_FILE
from surrogate.train import Trained


@pytest.fixture
def graph(scene: Scene, grid: PreviewGrid, trained: Trained) -> CheckerModule:
    return CheckerModule(
        scene, grid, trained.fit.residual, exposure=1.0, lam=1.0, spread=(-3.0, 0.0)
    )


def test_the_folder_holds_the_four_files_and_their_checksums_agree(model_folder: Path) -> None:
    assert {item.name for item in model_folder.iterdir()} == FILES
    subprocess.run(["sha256sum", "--check", "--strict", "checker.sha256"], cwd=model_folder,
                   check=True, capture_output=True)  # fmt: skip


def test_nothing_is_left_beside_the_folder(model_folder: Path) -> None:
    assert {item.name for item in model_folder.parent.iterdir()} == {"small", "small-training"}


def test_a_folder_with_other_files_is_left_alone(
    graph: CheckerModule, trained: Trained, tmp_path: Path
) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(ModelError, match=r"thesis\.txt"):
        write_package(tmp_path, graph, trained.metadata, "", {}, {})
    assert [item.name for item in tmp_path.iterdir()] == ["thesis.txt"]


def test_a_model_that_is_too_large_leaves_the_old_one_in_place(
    graph: CheckerModule, trained: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = shutil.copytree(trained.folder, tmp_path / "model")
    monkeypatch.setattr(package, "LARGEST", 10)
    # Exporting takes ten seconds, and what counts is what becomes of the file.
    whole = trained.folder / MODEL_FILE
    monkeypatch.setattr(package, "export_onnx", lambda *to: shutil.copy(whole, to[2]))
    with pytest.raises(ModelError, match="allowed: below 10"):
        write_package(old, graph, trained.metadata, "", {}, {})
    assert (old / "checker.onnx").read_bytes() == (trained.folder / "checker.onnx").read_bytes()
    assert [item.name for item in tmp_path.iterdir()] == ["model"]
