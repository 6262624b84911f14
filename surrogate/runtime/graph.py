"""What a model's graph may hold: the operators of our exports, and nothing that loops or reads.

A stranger's model is looked at before the runtime opens it, which already computes what is
constant. Read from the bytes of the file, as ``onnx.proto`` numbers its fields: a program with a
model needs no package for that.
"""

from __future__ import annotations

from collections.abc import Iterator

OPERATORS = {
    "Abs", "Add", "Cast", "Clip", "Concat", "Constant", "ConstantOfShape", "Cos", "Div",
    "Equal", "Exp", "Expand", "Flatten", "Gather", "Gemm", "Greater", "Identity", "Less", "Log",
    "MatMul", "Max", "Min", "Mul", "Neg", "Pow", "ReduceMax", "ReduceMean", "ReduceProd",
    "ReduceSum", "Relu", "Reshape", "Round", "Shape", "Sin", "Slice", "Split", "Sqrt",
    "Squeeze", "Sub", "Tanh", "Transpose", "Unsqueeze", "Where",
}  # fmt: skip
"""Of ONNX itself; every one of them ends, and none holds a graph of its own."""
MOST_NODES = 10_000
_GRAPH, _PROPERTY, _FUNCTIONS = 7, 14, 25
_NODE, _INITIALIZER, _SPARSE = 1, 5, 15
_OPERATOR, _ATTRIBUTE, _DOMAIN = 4, 5, 7
_TENSOR, _SUBGRAPH, _TENSORS, _SUBGRAPHS = 5, 6, 10, 11
_EXTERNAL, _LOCATION = 13, 14


def check_graph(content: bytes) -> dict[str, str]:
    """Return what a model says of itself, refusing one with more than `OPERATORS` and numbers.

    Raises:
        ValueError: says what it holds, or that it is no ONNX file.
    """
    nodes, said = 0, {}
    for number, graph in _fields(content):
        if number == _PROPERTY:
            name, text = dict(_fields(graph)).values()
            said[name.decode("utf-8")] = text.decode("utf-8")
        if number == _FUNCTIONS:
            raise ValueError("it holds functions of its own")
        for kind, part in _fields(graph) if number == _GRAPH else ():
            if kind == _NODE:
                nodes += 1
                _check_node(part)
            elif kind == _INITIALIZER:
                _check_tensor(part)
            elif kind == _SPARSE:
                raise ValueError("it holds sparse tensors")
    if not 0 < nodes <= MOST_NODES:
        raise ValueError(f"it has {nodes} operators, allowed: 1 to {MOST_NODES:,}")
    return said


def _check_node(node: bytes) -> None:
    operator, domain = "", ""
    for number, part in _fields(node):
        if number == _OPERATOR:
            operator = part.decode("utf-8")
        elif number == _DOMAIN:
            domain = part.decode("utf-8")
        elif number == _ATTRIBUTE:
            for kind, value in _fields(part):
                if kind in (_SUBGRAPH, _SUBGRAPHS):
                    raise ValueError("an operator holds a graph of its own, as loops do")
                if kind in (_TENSOR, _TENSORS):
                    _check_tensor(value)
    if domain not in ("", "ai.onnx") or operator not in OPERATORS:
        name = f"{domain}.{operator}" if domain else operator
        raise ValueError(f"it holds the operator {name!r}, which no model of ours has")


def _check_tensor(tensor: bytes) -> None:
    """Refuse numbers that lie in another file, or in the program's own memory."""
    for number, value in _fields(tensor):
        if number == _EXTERNAL or (number == _LOCATION and value != b"\x00"):
            raise ValueError("numbers of it lie outside of the file")


def _fields(message: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the fields of a Protocol Buffers message by number; of a varint, its bytes."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        kind, start = key & 7, at
        if kind == 0:
            _, at = _varint(message, at)
        elif kind == 2:
            size, start = _varint(message, at)
            at = start + size
        elif kind in (1, 5):
            at += 8 if kind == 1 else 4
        else:
            raise ValueError("it is no ONNX file")
        if at > len(message):
            raise ValueError("it is cut off")
        yield key >> 3, message[start:at]


def _varint(message: bytes, at: int) -> tuple[int, int]:
    """Return the number at ``at``, of ten bytes at most, and where the next thing begins."""
    value = 0
    for shift, byte in enumerate(message[at : at + 10]):
        value |= (byte & 0x7F) << 7 * shift
        if byte < 0x80:
            return value, at + shift + 1
    raise ValueError("it is cut off")
