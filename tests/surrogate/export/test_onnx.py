"""The ONNX file: the same numbers as torch, and nothing of the machine that made it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from render.scene import Scene
from render.transport import TransportTable
from surrogate.model.checker_module import CheckerModule, CheckerOutputs
from surrogate.model.preview_grid import PreviewGrid
from surrogate.runtime.metadata import read_props
from surrogate.runtime.model_file import INPUTS, MODEL_FILE, OUTPUTS
from surrogate.train import Trained


@pytest.fixture(scope="module")
def session(model_folder: Path) -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(
        str(model_folder / MODEL_FILE), providers=["CPUExecutionProvider"]
    )


def _feeds(scene: Scene, batch: int, bends: int, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    fibers = scene.lamp_count
    return {
        "phi": rng.uniform(0, np.pi, (batch, fibers)).astype(np.float32),
        "power": rng.uniform(0, 1, (batch, fibers, 3)).astype(np.float32),
        "bend": rng.uniform(0, np.pi / 2, (batch, bends)).astype(np.float32),
    }


@pytest.mark.parametrize("batch", [1, 7])
@pytest.mark.parametrize("bends", [1, 2, 3])
def test_onnx_gives_what_torch_gives_for_any_batch_and_bends(
    session: onnxruntime.InferenceSession,
    trained: Trained,
    scene: Scene,
    grid: PreviewGrid,
    batch: int,
    bends: int,
) -> None:
    spread = tuple(trained.metadata.residual["spread"])
    graph = CheckerModule(
        scene,
        grid,
        trained.fit.residual,
        exposure=trained.metadata.exposure,
        lam=trained.metadata.lam,
        spread=spread,
    )
    feeds = _feeds(scene, batch, bends)
    with torch.no_grad():
        expected = graph(*(torch.as_tensor(feeds[name]) for name in INPUTS))
    found = session.run(list(OUTPUTS), feeds)
    shape = (batch, bends, scene.sites.count, scene.indenter.faces, 3)
    assert found[0].shape == found[1].shape == shape
    for name, here, there in zip(OUTPUTS, expected, found, strict=True):
        np.testing.assert_allclose(there, here.numpy(), rtol=2e-4, atol=2e-3, err_msg=name)


def test_the_file_keeps_the_contract(model_folder: Path, scene: Scene) -> None:
    model = onnx.load(model_folder / MODEL_FILE, load_external_data=False)
    assert model.ir_version == 8
    assert [(o.domain, o.version) for o in model.opset_import] == [("", 18)]
    assert all(t.data_location == onnx.TensorProto.DEFAULT for t in model.graph.initializer)
    assert (model_folder / MODEL_FILE).stat().st_size < 5_000_000

    def axes(value: onnx.ValueInfoProto) -> list[str | int]:
        return [d.dim_param or d.dim_value for d in value.type.tensor_type.shape.dim]

    fibers, sites, facets = scene.lamp_count, scene.sites.count, scene.indenter.faces
    assert {i.name: axes(i) for i in model.graph.input} == {
        "phi": ["batch", fibers],
        "power": ["batch", fibers, 3],
        "bend": ["batch", "bends"],
    }
    assert {o.name: axes(o) for o in model.graph.output} == {
        "counts": ["batch", "bends", sites, facets, 3],
        "counts_spread": ["batch", "bends", sites, facets, 3],
        "background": ["batch", "bends", sites, 3],
        "metric": ["batch", "bends", sites],
        "score": ["batch"],
        "domain_excess": ["batch"],
    }
    assert CheckerOutputs._fields == OUTPUTS


def test_nodes_say_nothing_about_the_machine(model_folder: Path) -> None:
    model = onnx.load(model_folder / MODEL_FILE)
    for node in model.graph.node:
        assert not node.doc_string
        assert not node.metadata_props
        assert "/" not in "".join([node.name, *node.input, *node.output])
    assert not model.functions


def test_the_metadata_describe_the_model(
    model_folder: Path, scene: Scene, reference: TransportTable
) -> None:
    model = onnx.load(model_folder / MODEL_FILE)
    about = read_props({p.key: p.value for p in model.metadata_props}, "model")
    assert about.scene_hash == scene.hash
    assert (about.fibers, about.sites, about.facets) == (8, 6, 6)
    assert about.bounds["bend"] == [0.0, pytest.approx(math.pi / 2)]
    assert about.conformal["coverage"] == 0.9
    assert len(about.training_data_hash) == 64
    placed = {row["name"]: (row["level"], row["effort"]) for row in about.held_out}
    assert placed["noise of the reference"] == ("reference", None)
    assert placed["preview"] == ("preview", None)
    assert placed["ridge"] == ("surrogate", "ridge")
    assert placed["network"] == ("surrogate", "network")


@pytest.mark.parametrize("name", INPUTS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_input_that_is_not_finite_gives_nan_and_excess(
    session: onnxruntime.InferenceSession, scene: Scene, name: str, value: float
) -> None:
    feeds = _feeds(scene, 2, 3)
    clean = dict(zip(OUTPUTS, session.run(list(OUTPUTS), feeds), strict=True))
    feeds[name][1].reshape(-1)[1] = value
    found = dict(zip(OUTPUTS, session.run(list(OUTPUTS), feeds), strict=True))
    assert np.isnan(found["score"][1])
    assert np.isnan(found["counts"][1]).any()
    assert found["domain_excess"][1] == math.inf
    assert found["domain_excess"][0] == 0.0
    np.testing.assert_allclose(found["counts"][0], clean["counts"][0], rtol=1e-5)


def test_an_answer_beyond_the_trained_range_is_that_of_its_edge_and_says_so(
    session: onnxruntime.InferenceSession, scene: Scene
) -> None:
    feeds = _feeds(scene, 1, 1)
    feeds["bend"][:] = np.float32(np.pi / 2)
    edge = dict(zip(OUTPUTS, session.run(list(OUTPUTS), feeds), strict=True))
    feeds["bend"][:] = np.pi
    beyond = dict(zip(OUTPUTS, session.run(list(OUTPUTS), feeds), strict=True))
    np.testing.assert_array_equal(edge["counts"], beyond["counts"])
    assert edge["domain_excess"][0] == 0.0
    assert beyond["domain_excess"][0] == pytest.approx(1.0)
