"""From the torch module to one self-contained ONNX file (opset 18, IR 8)."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Mapping
from pathlib import Path

import torch

from render.files import write_bytes
from surrogate.model.checker_module import CheckerModule
from surrogate.runtime.model_file import INPUTS, MATERIAL, OUTPUTS

OPSET = 18
IR_VERSION = 8


def export_onnx(
    checker: CheckerModule, fibers: int, path: Path, metadata: Mapping[str, str]
) -> None:
    """Write ``checker`` to ``path`` with named dynamic axes ``batch`` and ``bends``.

    Node metadata and doc strings, where exporters leave source paths of the machine, are removed;
    ``metadata`` becomes the model's ``metadata_props``.
    """
    import onnx

    batch, bends = torch.export.Dim("batch"), torch.export.Dim("bends")
    # Sizes that occur nowhere else, so that no axis can be taken for a constant.
    example: tuple[torch.Tensor, ...] = (
        torch.full((5, fibers), 1.5),
        torch.full((5, fibers, 3), 0.5),
        torch.zeros(5, 7),
    )
    low, high = checker.bends
    example[2].fill_(0.5 * (low + high))
    names, axes = list(INPUTS), [{0: batch}, {0: batch}, {0: batch, 1: bends}]
    if checker.free is not None:
        nominal = torch.as_tensor(checker.free.nominal, dtype=torch.float32)
        example = (*example, nominal.tile(5, 1))
        names.append(MATERIAL)
        axes.append({0: batch})
    with warnings.catch_warnings(), torch.no_grad():
        # The exporter warns about its own internals (deprecated pytree calls).
        warnings.simplefilter("ignore")
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)
        program = torch.onnx.export(
            checker.eval(),
            example,
            input_names=names,
            output_names=list(OUTPUTS),
            opset_version=OPSET,
            dynamic_shapes=tuple(axes),
            external_data=False,
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    model.ir_version = IR_VERSION
    model.producer_name, model.producer_version = "tactilux", ""
    _strip(model.graph)
    del model.functions[:]
    del model.metadata_props[:]
    for key, value in metadata.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    onnx.checker.check_model(model, full_check=True)
    write_bytes(path, model.SerializeToString(deterministic=True))


def _strip(graph: object) -> None:
    """Remove what says where and how the graph was traced."""
    for node in graph.node:  # type: ignore[attr-defined]
        node.doc_string = ""
        del node.metadata_props[:]
    for group in ("value_info", "input", "output", "initializer"):
        for item in getattr(graph, group):
            item.doc_string = ""
            del item.metadata_props[:]
    graph.doc_string = ""  # type: ignore[attr-defined]
    del graph.metadata_props[:]  # type: ignore[attr-defined]
