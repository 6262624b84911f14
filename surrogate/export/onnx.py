"""From the torch module to one self-contained ONNX file (opset 18, IR 8)."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from render.files import write_bytes
from surrogate.model.checker_module import CheckerModule
from surrogate.runtime.model_file import INPUTS, MATERIAL, OUTPUTS

if TYPE_CHECKING:
    from onnx import GraphProto

OPSET = 18
IR_VERSION = 8
BATCH, BENDS = "batch", "bends"


def export_onnx(
    checker: CheckerModule, fibers: int, path: Path, metadata: Mapping[str, str]
) -> None:
    """Write ``checker`` to ``path`` with named dynamic axes ``batch`` and ``bends``.

    The graph is traced, as TorchScript is: torch calls that way its older one, but `torch.export`
    takes 8 to 15 s of symbolic shapes for the same numbers to the last bit, tracing half a second.
    Nodes keep nothing of their names and doc strings, where exporters leave paths of the machine;
    ``metadata`` becomes the model's ``metadata_props``.
    """
    import onnx

    # Sizes that occur nowhere else, so that no axis can be taken for another.
    example: tuple[torch.Tensor, ...] = (
        torch.full((5, fibers), 1.5),
        torch.full((5, fibers, checker.channels), 0.5),
        torch.full((5, 7), 0.5 * sum(checker.bends)),
    )
    names = list(INPUTS)
    if checker.free is not None:
        nominal = torch.as_tensor(checker.free.nominal, dtype=torch.float32)
        example, names = (*example, nominal.tile(5, 1)), [*names, MATERIAL]
    file = io.BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        # Of its age, and of sizes that are compared in Python: other sizes are tested.
        warnings.simplefilter("ignore")
        shapes = [output.shape for output in checker.eval()(*example)]
        torch.onnx.export(
            checker,
            example,
            file,  # type: ignore[arg-type]  # what this exporter documents
            input_names=names,
            output_names=list(OUTPUTS),
            opset_version=OPSET,
            dynamic_axes={name: {0: BATCH} for name in names} | {"bend": {0: BATCH, 1: BENDS}},
            dynamo=False,
        )
    model = onnx.load_from_string(file.getvalue())
    model.ir_version = IR_VERSION
    model.producer_name, model.producer_version = "tactilux", ""
    _rename(model.graph)
    _name_axes(model.graph, shapes)
    del model.metadata_props[:]
    for key, value in metadata.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    onnx.checker.check_model(model, full_check=True)
    write_bytes(path, model.SerializeToString(deterministic=True))


def _rename(graph: GraphProto) -> None:
    """Number nodes and what flows between them; inputs, outputs and constants keep their names."""
    kept = {value.name for value in (*graph.input, *graph.output, *graph.initializer)}
    names: dict[str, str] = {}

    def renamed(values: Iterable[str]) -> list[str]:
        return [names.setdefault(v, v if v in kept or not v else f"v{len(names)}") for v in values]

    for number, node in enumerate(graph.node):
        node.name, node.doc_string = f"n{number}", ""
        node.input[:], node.output[:] = renamed(node.input), renamed(node.output)
        del node.metadata_props[:]
    del graph.value_info[:]


def _name_axes(graph: GraphProto, shapes: Iterable[torch.Size]) -> None:
    """Give the outputs their axes: batch, bends where there are several, and sizes."""
    for output, shape in zip(graph.output, shapes, strict=True):
        for axis, size in enumerate(output.type.tensor_type.shape.dim):
            if axis < min(2, len(shape)):
                size.dim_param = (BATCH, BENDS)[axis]
            else:
                size.dim_value = shape[axis]
