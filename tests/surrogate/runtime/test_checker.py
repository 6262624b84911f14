"""Running a model folder, and refusing what is no such folder."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest

from render.errors import ModelError
from render.scene import Scene
from surrogate.runtime import Checker
from surrogate.runtime.model_file import GOLDEN_FILE, MODEL_FILE, SUM_FILE, SUMMED, sums_of


@pytest.fixture(scope="module")
def checker(model_folder: Path, scene: Scene) -> Checker:
    return Checker.load(model_folder, scene.hash)


@pytest.fixture
def copy(model_folder: Path, tmp_path: Path) -> Path:
    return shutil.copytree(model_folder, tmp_path / "model")


def row(**changed: object) -> dict[str, object]:
    """Return errors of held-out designs as a model has them, with something ``changed``."""
    known = {"name": "network", "level": "surrogate", "effort": "network"}
    return {**known, "kendall_tau": 0.9, "facet_median": 0.1, **changed}


def _edit(folder: Path, change: str) -> Path:
    """Change the model and drop its checksum; return the file alone."""
    model = onnx.load(folder / MODEL_FILE)
    (folder / SUM_FILE).unlink()
    if change == "opset":
        model.opset_import[0].version = 999
    elif change == "foreign":
        del model.metadata_props[:]
    elif change == "damaged":
        next(p for p in model.metadata_props if p.key == "bounds").value = "{"
    elif change == "renamed":
        for value in [model.graph.output[0], *model.graph.node]:
            if isinstance(value, onnx.ValueInfoProto):
                value.name = "colors"
            else:
                value.output[:] = ["colors" if n == "counts" else n for n in value.output]
                value.input[:] = ["colors" if n == "counts" else n for n in value.input]
    (folder / MODEL_FILE).write_bytes(model.SerializeToString())
    return folder / MODEL_FILE


def test_batches_of_any_size_give_the_same_answers(checker: Checker, scene: Scene) -> None:
    rng = np.random.default_rng(0)
    fibers = scene.lamp_count
    phi, power = rng.uniform(0, np.pi, (130, fibers)), rng.uniform(0, 1, (130, fibers, 3))
    bends = np.array(scene.bending.angles)
    many = checker.run(phi, power, bends)
    one = checker.run(phi[129:], power[129:], bends)
    for name, value in one.items():
        np.testing.assert_allclose(many[name][129:], value, rtol=1e-4, atol=1e-3)


def test_the_transport_table_superposes_to_the_counts(checker: Checker, scene: Scene) -> None:
    phi = np.array([0.4, 1.5, 2.9])
    table = checker.transport_table(phi)
    assert table.T.shape == (8, 3, 3, 6, 6)
    assert (table.level, table.scene_hash) == ("surrogate", scene.hash)
    assert table.bends.tolist() == list(scene.bending.angles)
    power = np.random.default_rng(0).uniform(0, 0.5, (1, 8, 3))
    directions = np.array([0, 1, 2, 0, 1, 2, 0, 1])
    light = table.T[np.arange(8), directions]
    expected = table.exposure * np.einsum("fbsk,fc->bskc", light, power[0])
    found = checker.run(phi[directions][None], power, table.bends)["counts"][0]
    np.testing.assert_allclose(found, np.minimum(expected, 255.0), rtol=1e-4, atol=1e-3)


def test_the_transport_table_has_errors_and_background(checker: Checker) -> None:
    table = checker.transport_table(np.array([1.0]))
    assert (table.se > 0).all()
    assert table.background is not None
    assert table.background.shape == (8, 1, 3, 6)
    assert (table.background > 0).all()


def test_intervals_come_with_the_model(checker: Checker) -> None:
    assert checker.score_half_width > 0
    assert checker.counts_factor > 0
    assert checker.coverage == 0.9


def test_bends_beyond_the_trained_range_are_answered_with_excess(checker: Checker) -> None:
    phi, power = np.full((1, 8), 1.5), np.ones((1, 8, 3))
    assert checker.run(phi, power, np.array([np.pi]))["domain_excess"][0] > 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"phi": np.full((1, 8), 90.0)}, "phi = 90 rad, allowed: 0 to 3.14159; if these are deg"),
        ({"phi": np.full((1, 8), -0.1)}, "phi = -0.1 rad, allowed: 0 to 3.14159; correct"),
        ({"phi": np.full((1, 8), math.nan)}, "phi = nan rad, allowed: 0 to"),
        ({"power": np.full((1, 8, 3), 255.0)}, "power = 255 of full power, allowed: 0 to 1"),
        ({"bends": np.array([45.0])}, "bends = 45 rad, allowed: 0 to 3.14159; if these are deg"),
        ({"phi": np.ones(8)}, r"phi has shape \(8,\), allowed: \(designs, 8\)"),
        ({"phi": np.ones((1, 7))}, r"phi has shape \(1, 7\)"),
        ({"power": np.ones((2, 8, 3))}, r"power has shape \(2, 8, 3\), allowed: \(1, 8, 3\)"),
        ({"bends": np.zeros((1, 3))}, r"bends has shape \(1, 3\), allowed: \(bends,\)"),
    ],
)
def test_wrong_input_is_one_sentence(
    checker: Checker, change: dict[str, np.ndarray], message: str
) -> None:
    inputs = {"phi": np.ones((1, 8)), "power": np.ones((1, 8, 3)), "bends": np.zeros(1)} | change
    with pytest.raises(ModelError, match=message) as caught:
        checker.run(**inputs)
    assert "\n" not in str(caught.value)


def test_an_altered_file_is_refused(copy: Path) -> None:
    content = bytearray((copy / MODEL_FILE).read_bytes())
    content[len(content) // 2] ^= 1
    (copy / MODEL_FILE).write_bytes(content)
    with pytest.raises(ModelError, match="was altered"):
        Checker.load(copy)
    with pytest.raises(ModelError, match="was altered"):
        Checker.load(copy / MODEL_FILE)


def test_a_folder_without_checksum_is_refused(copy: Path) -> None:
    (copy / SUM_FILE).unlink()
    with pytest.raises(ModelError, match="no checksum"):
        Checker.load(copy)


def test_a_model_of_another_scene_is_refused(model_folder: Path) -> None:
    with pytest.raises(ModelError, match="another scene"):
        Checker.load(model_folder, "0123456789abcdef")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot be read"):
        Checker.load(tmp_path)


@pytest.mark.parametrize("content", [b"", b"not a model", b"\x08\x08" + b"\xff" * 400])
def test_a_corrupt_file_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / MODEL_FILE).write_bytes(content)
    with pytest.raises(ModelError, match="is no model of ours"):
        Checker.load(tmp_path / MODEL_FILE)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("opset", "cannot be run by onnxruntime"),
        ("foreign", "is not a tactilux model"),
        ("damaged", "has a damaged description"),
        ("renamed", "has inputs"),
    ],
)
def test_a_foreign_model_is_refused(copy: Path, change: str, message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        Checker.load(_edit(copy, change))
    assert "\n" not in str(caught.value)


def test_a_file_without_a_folder_runs_as_well(copy: Path, scene: Scene) -> None:
    (copy / SUM_FILE).unlink()
    assert Checker.load(copy / MODEL_FILE, scene.hash).metadata.scene == "finger20"


def test_running_a_model_needs_neither_torch_nor_opengl(model_folder: Path) -> None:
    program = (
        "import sys; from surrogate.runtime import Checker; import numpy as np; "
        f"c = Checker.load({str(model_folder)!r}); "
        "c.run(np.ones((1, 8)), np.ones((1, 8, 3)), np.zeros(1)); "
        "bad = {'torch', 'moderngl', 'mitsuba', 'sklearn', 'scipy'} & set(sys.modules); "
        "sys.exit(', '.join(bad) or 0)"
    )
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=root, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_a_model_whose_scale_depended_on_noise_is_refused(copy: Path) -> None:
    model = onnx.load(copy / MODEL_FILE)
    next(p for p in model.metadata_props if p.key == "schema").value = "tactilux-checker-1"
    (copy / SUM_FILE).unlink()
    (copy / MODEL_FILE).write_bytes(model.SerializeToString())
    with pytest.raises(ModelError, match="make it again with `tactilux train`"):
        Checker.load(copy / MODEL_FILE)


def _written(folder: Path, model: onnx.ModelProto) -> Path:
    """Write a changed model with a checksum that is right, as a stranger would."""
    (folder / MODEL_FILE).write_bytes(model.SerializeToString())
    contents = {name: (folder / name).read_bytes() for name in SUMMED}
    (folder / SUM_FILE).write_text(sums_of(contents))
    return folder


def _with_node(folder: Path, kind: str) -> Path:
    """Let a score go through an operator that no model of ours has."""
    model = onnx.load(folder / MODEL_FILE)
    graph = model.graph
    for node in graph.node:
        node.output[:] = ["score before" if name == "score" else name for name in node.output]
    helper, number = onnx.helper, onnx.TensorProto
    same = helper.make_tensor_value_info("x", number.FLOAT, None)
    go_on = helper.make_tensor_value_info("c", number.BOOL, [])
    on = helper.make_node("Identity", ["c"], ["c2"]), helper.make_node("Identity", ["x"], ["y"])
    later = [helper.make_tensor_value_info(n, t, None) for n, t in (("c2", number.BOOL), ("y", 1))]
    if kind == "Loop":
        step = helper.make_tensor_value_info("i", number.INT64, [])
        body = helper.make_graph(on, "body", [step, go_on, same], later)
        yes = helper.make_tensor("yes", number.BOOL, [], [True])
        graph.initializer.append(yes)
        node = helper.make_node("Loop", ["", "yes", "score before"], ["score"], body=body)
    elif kind == "domain":
        node = helper.make_node("Tanh", ["score before"], ["score"], domain="com.microsoft")
        model.opset_import.append(helper.make_opsetid("com.microsoft", 1))
    elif kind == "external":
        node = helper.make_node("Add", ["score before", "far"], ["score"])
        tensor = helper.make_tensor("far", number.FLOAT, [1], [0.0])
        tensor.ClearField("float_data")
        tensor.data_location = number.EXTERNAL
        for key, value in (("location", "/etc/hostname"), ("length", "4")):
            entry = tensor.external_data.add()
            entry.key, entry.value = key, value
        graph.initializer.append(tensor)
    else:
        node = helper.make_node(kind, ["score before"], ["score"])
    graph.node.append(node)
    return _written(folder, model)


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        ("Loop", "holds a graph of its own"),
        ("domain", "the operator 'com.microsoft.Tanh'"),
        ("Erf", "the operator 'Erf'"),
        ("external", "lie outside of the file"),
    ],
)
def test_a_strangers_model_that_holds_what_no_model_of_ours_does_is_refused_unopened(
    copy: Path, kind: str, why: str
) -> None:
    folder = _with_node(copy, kind)
    with pytest.raises(ModelError, match=f"is no model of ours: .*{why}"):
        Checker.load(folder)
    with pytest.raises(ModelError, match=f"is no model of ours: .*{why}"):
        Checker.load(folder / MODEL_FILE)


def test_a_model_that_does_not_say_what_its_golden_pair_says_is_refused(copy: Path) -> None:
    folder = _with_node(copy, "Neg")
    with pytest.raises(ModelError, match=r"does not say what its golden pair says \(score\)"):
        Checker.load(folder)


def test_a_golden_pair_that_was_altered_is_refused(copy: Path) -> None:
    content = bytearray((copy / GOLDEN_FILE).read_bytes())
    content[len(content) // 2] ^= 1
    (copy / GOLDEN_FILE).write_bytes(content)
    with pytest.raises(ModelError, match=r"golden\.npz was altered"):
        Checker.load(copy)


def test_an_error_while_a_model_runs_is_one_sentence(copy: Path, checker: Checker) -> None:
    model = onnx.load(copy / MODEL_FILE)
    # Whatever else a stranger has put there: this fails with more than one design alone.
    one = onnx.helper.make_tensor("one", onnx.TensorProto.INT64, [1], [1])
    for node in model.graph.node:
        node.output[:] = ["score before" if name == "score" else name for name in node.output]
    model.graph.initializer.append(one)
    model.graph.node.append(onnx.helper.make_node("Reshape", ["score before", "one"], ["score"]))
    (copy / GOLDEN_FILE).unlink()
    (copy / SUM_FILE).unlink()
    (copy / MODEL_FILE).write_bytes(model.SerializeToString())
    altered = Checker.load(copy / MODEL_FILE)
    assert altered.run(np.ones((1, 8)), np.ones((1, 8, 3)), np.zeros(1))["score"].shape == (1,)
    with pytest.raises(ModelError, match="cannot be run by onnxruntime") as caught:
        altered.run(np.ones((2, 8)), np.ones((2, 8, 3)), np.zeros(1))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("conformal", {"coverage": -3, "counts": 1.0, "score": 1.0}),
        ("conformal", {"coverage": 0.9, "counts": -1.0, "score": 1.0}),
        ("exposure", -5.0),
        ("lam", -1.0),
        ("fibers", 0),
        ("sites", 1e9),
        ("facets", 2.5),
        ("scene_bends", []),
        ("bounds", {"phi": [0, 9], "power": [0, 1], "bend": [0, 1]}),
        ("bounds", {"phi": [3, 1], "power": [0, 1], "bend": [0, 1]}),
        ("held_out", [row(kendall_tau=7)]),
        ("held_out", [row(level="network")]),
        ("held_out", [row(effort="many renders")]),
        ("residual", {"cells": 10}),
        ("residual", {"kind": "network", "cells": 0}),
        ("renderer", {"samples_per_cell": "many"}),
        ("conventions", {"count_max": -255.0}),
    ],
)
def test_a_description_that_nothing_can_have_is_refused(
    copy: Path, key: str, value: object
) -> None:
    model = onnx.load(copy / MODEL_FILE)
    next(p for p in model.metadata_props if p.key == key).value = json.dumps(value)
    with pytest.raises(ModelError, match="has a damaged description"):
        Checker.load(_written(copy, model))


def test_a_description_of_other_sizes_than_the_outputs_is_refused(copy: Path) -> None:
    model = onnx.load(copy / MODEL_FILE)
    next(p for p in model.metadata_props if p.key == "sites").value = "7"
    with pytest.raises(ModelError, match=r"gives counts of shape .* and describes"):
        Checker.load(_written(copy, model))
