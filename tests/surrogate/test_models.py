"""Every shipped model replays its golden pair through onnxruntime alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from surrogate.checker import Checker

MODELS = Path(__file__).resolve().parents[2] / "models"
FOLDERS = sorted(path.parent for path in MODELS.glob("*/checker.onnx"))
INPUTS = ("phi", "power", "bend")


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_shipped_model_replays_its_golden_pair(folder: Path) -> None:
    with np.load(folder / "golden.npz", allow_pickle=False) as stored:
        golden = {name: stored[name] for name in stored.files}
    session = onnxruntime.InferenceSession(
        str(folder / "checker.onnx"), providers=["CPUExecutionProvider"]
    )
    outputs = [name for name in golden if name not in INPUTS]
    assert set(outputs) == {output.name for output in session.get_outputs()}
    found = session.run(outputs, {name: golden[name] for name in INPUTS})
    for name, value in zip(outputs, found, strict=True):
        np.testing.assert_allclose(value, golden[name], rtol=1e-4, atol=1e-3, err_msg=name)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_shipped_folder_is_whole_and_unaltered(folder: Path) -> None:
    found = {item.name for item in folder.iterdir()}
    assert found == {"checker.onnx", "checker.md", "checker.sha256", "golden.npz"}
    assert Checker.load(folder).metadata.scene == folder.name
